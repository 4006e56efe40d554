"""Whether time runs as it should: rates, jitter, gaps, missing samples, steps back."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.findings import Part, Severity
from navlearn.logs.quality.signals import Array, column, in_order, median_interval

_LONG = {"imu": (1.0, 10.0), "odometer": (3.0, 30.0), "fixes": (10.0, float("inf"))}
"""Gap that earns a warning and one that ruins a result, s; a reference may pause."""

_EMPTY: Final[dict[str, tuple[Severity, str, str]]] = {
    "imu": ("error", "inertial samples", "check the reader's file and column names"),
    "odometer": (
        "info",
        "samples of speed, for dead reckoning with one gyro",
        "use methods of the full IMU, or make an odometer from a reference",
    ),
    "fixes": (
        "warning",
        "GNSS solutions",
        "make them from the reference (log.aiding of a recipe) or from raw ranges, or add a file",
    ),
    "reference": ("warning", "a better solution to judge with", "judge with the fixes"),
}


def check_timing(log: DriveLog) -> Part:
    """Check the times of every table as they were read."""
    part = Part()
    for name, table in log.tables().items():
        if name == "ranges":
            table = table.drop_duplicates("t")  # the satellites of one reception share their time
        t = column(table, "t")
        if len(table) == 0 and name not in _EMPTY:
            continue
        if len(table) == 0:
            severity, expected, remedy = _EMPTY[name]
            part.add(severity, "empty table", name, "no rows", expected, remedy)
            continue
        _check_order(part, name, t)
        _measure(part, name, column(in_order(table), "t"))
    _check_overlap(part, log)
    return part


def _check_order(part: Part, name: str, t: Array) -> None:
    lost = int(np.count_nonzero(~np.isfinite(t)))
    if lost:
        part.add(
            "error",
            "time missing",
            name,
            f"{lost} rows without a time",
            "a finite time in every row",
            "drop those rows in the reader",
        )
        t = t[np.isfinite(t)]
    step = np.diff(t)
    for topic, bad in (("time reversal", step < 0.0), ("duplicate stamps", step == 0.0)):
        if np.any(bad):
            row = int(np.flatnonzero(bad)[0]) + 1
            part.add(
                "error",
                topic,
                f"{name} row {row}",
                f"{np.count_nonzero(bad)} times, first {t[row]:.3f} s after {t[row - 1]:.3f} s",
                "strictly increasing time",
                "sort the table and keep one row per time, or repair the clock at its source",
            )


def _measure(part: Part, name: str, t: Array) -> None:
    if len(t) < 2:
        return
    interval = max(median_interval(t), 1e-9)
    step = np.diff(t)
    regular = step < 1.5 * interval
    part.figures[f"{name}_rate_hz"] = 1.0 / interval
    part.figures[f"{name}_jitter_s"] = float(np.std(step[regular])) if np.any(regular) else 0.0
    part.figures[f"{name}_longest_gap_s"] = float(np.max(step))
    missing = np.round(step / interval).astype(np.int64) - 1
    missing[regular] = 0
    part.figures[f"{name}_missing"] = float(np.sum(missing))
    part.figures[f"{name}_interruptions"] = float(np.count_nonzero(missing))
    for index in np.flatnonzero((step > 2.5 * interval) & (step > 0.25)):
        part.gaps.append((name, float(t[index]), float(step[index])))
    _note_missing_fixes(part, name, t, missing)
    warn, ruin = _LONG.get(name, (float("inf"), float("inf")))
    worst = int(np.argmax(step))
    if step[worst] > max(warn, 2.5 * interval):
        severity: Severity = "error" if step[worst] > ruin else "warning"
        count = int(np.count_nonzero(step > max(warn, 2.5 * interval)))
        part.add(
            severity,
            "gap",
            f"{name} at {t[worst]:.2f} s",
            f"{count} gaps over {warn:g} s, the longest {step[worst]:.2f} s",
            f"a sample every {interval:.3g} s",
            "cut the log there, or place outages elsewhere",
        )


def _note_missing_fixes(part: Part, name: str, t: Array, missing: NDArray[np.int64]) -> None:
    count = int(np.count_nonzero(missing))
    if name != "fixes" or count == 0:
        return
    part.add(
        "info",
        "missing fixes",
        f"fixes first at {t[int(np.flatnonzero(missing)[0])]:.2f} s",
        f"{np.sum(missing)} fixes missing in {count} interruptions, "
        f"{np.count_nonzero(missing == 1)} of them of a single fix",
        "a fix at every interval",
        "nothing for single ones; place no outage across long ones",
    )


def _check_overlap(part: Part, log: DriveLog) -> None:
    imu = column(in_order(log.imu), "t")
    if len(imu) < 2:
        return
    for name, table in log.tables().items():
        t = column(in_order(table), "t")
        if name == "imu" or len(t) == 0:
            continue
        inside = np.mean((t >= imu[0] - 1.0) & (t <= imu[-1] + 1.0))
        part.figures[f"{name}_within_imu_share"] = float(inside)
        if inside < 0.5:
            part.add(
                "error",
                "clocks apart",
                name,
                f"{100 * inside:.0f} % of its rows lie within the time of the IMU "
                f"({imu[0]:.1f} to {imu[-1]:.1f} s; {name} {t[0]:.1f} to {t[-1]:.1f} s)",
                "tables of one drive on one clock",
                "give both tables the same time origin and unit (s, not ms) in the reader",
            )
