"""Whether the clocks of the streams agree: latencies and their drift; positive is late."""

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.calibration import (
    combined,
    ways_to_gnss_latency,
    ways_to_odometer_latency,
)
from navlearn.logs.quality.findings import Part
from navlearn.logs.quality.latency import Estimate, Latency, Stream, compare

_PAIRS: tuple[tuple[str, Stream, Stream], ...] = (
    ("gnss_latency_by_turns", "fixes", "imu"),
    ("odometer_latency_to_gnss", "odometer", "fixes"),
)


def check_clocks(log: DriveLog) -> Part:
    """Estimate how late fixes, odometer and reference are stamped against the IMU."""
    part = Part()
    gnss_ways = ways_to_gnss_latency(log)
    gnss = combined(gnss_ways)
    odometer_ways = ways_to_odometer_latency(log, gnss)
    odometer = combined(odometer_ways)
    _note_combined(part, "gnss_latency", gnss, gnss_ways)
    _note_combined(part, "odometer_latency", odometer, odometer_ways)
    for name, stream, against in _PAIRS:
        _note_drift(part, name, stream, compare(log, stream, against, with_drift=True))
    reference = compare(log, "reference", "imu")
    if isinstance(reference, str):
        part.not_observable["reference_latency_s"] = reference
    else:
        part.note("reference_latency", reference.delay, reference.std, "_s")
    _judge(part, log, "fixes", gnss, log.metadata.gnss_latency)
    _judge(part, log, "odometer", odometer, log.metadata.odometer_latency)
    return part


def _note_combined(
    part: Part, name: str, found: Estimate | None, ways: dict[str, Estimate]
) -> None:
    if found is None:
        part.not_observable[f"{name}_s"] = "neither turns nor changes of speed tell it"
        return
    part.note(name, found.value, found.std, "_s")
    for way, estimate in ways.items():
        part.note(f"{name}_{way}", estimate.value, estimate.std, "_s")


def _note_drift(part: Part, name: str, stream: Stream, found: Latency | str) -> None:
    if isinstance(found, str):
        part.not_observable[f"{name}_s"] = found
        return
    if f"{name}_s" not in part.figures:
        part.note(name, found.delay, found.std, "_s")
    part.figures[f"{name}_at_start_s"] = found.at_start
    part.figures[f"{name}_at_end_s"] = found.at_end
    if found.drifts and abs(found.at_end - found.at_start) > 0.15:
        part.add(
            "warning",
            "clock drift",
            stream,
            f"{name.replace('_', ' ')} runs from {found.at_start:+.2f} to {found.at_end:+.2f} s",
            "one clock, or a constant latency",
            "estimate the latency anew along the drive, or rescale the stream's time",
        )


def _judge(part: Part, log: DriveLog, table: str, found: Estimate | None, stated: float) -> None:
    removed = log.metadata.latency_removed
    if removed:
        name = "gnss" if table == "fixes" else table
        part.figures[f"{name}_latency_removed_s"] = stated
    expected = 0.0 if removed else stated
    if found is None or abs(found.value - expected) < max(0.08, 4.0 * found.std):
        return
    word = "late" if found.value > 0.0 else "early"
    part.add(
        "warning" if abs(found.value - expected) > 0.6 else "info",
        "latency",
        table,
        f"stamped {abs(found.value):.2f} ± {found.std:.2f} s {word} against the IMU",
        f"0 s, {stated:g} s being taken off already" if removed else f"the stated {stated:g} s",
        f"state a latency of {found.value + stated * removed:+.2f} s in the descriptor",
    )
