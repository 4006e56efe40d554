"""A stretch of a log in which the car stands, without gaps: what an Allan variance is taken of."""

from dataclasses import dataclass

import numpy as np

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_means import known_samples, sampling_of
from navlearn.logs.ins_standstill import standstill_intervals
from navlearn.logs.interval_means import FloatArray, interval_means, typical_period
from navlearn.logs.six_axes import ACCELEROMETERS, GYROS
from navlearn.logs.stationary import BoolArray, stationary_intervals

AXES = (*GYROS, *ACCELEROMETERS)

LEAST = 20.0
"""Shortest stretch that tells any noise, s: white noise, to a tenth or so."""

GAP = 2.5
"""Samples further apart than so many periods have some missing between them, whatever the jitter
of their stamps."""

MISSING = 0.005
"""Share of samples that may be missing one by one."""

ROCKING = 1.0
"""A car rocks for this long after it stops, and is about to before it starts, s."""

_STEP = 0.1
"""Length of the intervals in which standstill is looked for, s."""


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """Part of a log.

    Attributes:
        start: First time, s.
        stop: Last time, s.
    """

    start: float
    stop: float

    @property
    def length(self) -> float:
        """Length, s."""
        return self.stop - self.start


def still_stretches(log: DriveLog) -> list[Stretch]:
    """Return where the car stands and the IMU misses no sample, the longest first.

    The odometer tells, confirmed by the IMU, where there is an odometer; else all six axes do.

    Args:
        log: Drive.

    Raises:
        LogError: There is neither an odometer nor a full IMU to tell.
    """
    edges, still = _still(log)
    t = log.imu["t"].to_numpy(np.float64)
    broken = t[:-1][np.diff(t) > GAP * typical_period(t)]
    ends = [t[np.searchsorted(t, at, side="right")] for at in broken]
    change = np.diff(np.concatenate(([0], still.astype(np.int8), [0])))
    found: list[Stretch] = []
    for first, last in zip(np.flatnonzero(change > 0), np.flatnonzero(change < 0), strict=True):
        start, stop = edges[first] + ROCKING, edges[last] - ROCKING
        cuts = [(a, b) for a, b in zip(broken, ends, strict=True) if a < stop and b > start]
        begins = [start, *(b for _, b in cuts)]
        stops = [*(a for a, _ in cuts), stop]
        found += [
            Stretch(start=float(a), stop=float(b))
            for a, b in zip(begins, stops, strict=True)
            if b > a
        ]
    return sorted(found, key=lambda one: -one.length)


def stretch_of(log: DriveLog, start: float | None = None, stop: float | None = None) -> Stretch:
    """Return the stretch to look at: what is asked for, or the longest standstill.

    Args:
        log: Drive.
        start: First time, s; None with ``stop`` None looks for a standstill.
        stop: Last time, s; None goes to the end.

    Raises:
        LogError: It is too short, or nothing stands long enough.
    """
    t = log.imu["t"].to_numpy(np.float64)
    if start is None and stop is None:
        found = still_stretches(log)
        if not found or found[0].length < LEAST:
            longest = f"the longest lasts {found[0].length:.0f} s" if found else "there is none"
            raise LogError(
                f"{log.metadata.name}: {longest} of standstill without gaps; {LEAST:g} s or more "
                "tell a noise: give a log that stands longer, or say where it does (--from, "
                "--until)"
            )
        return found[0]
    first = float(t[0]) if start is None else max(start, float(t[0]))
    last = float(t[-1]) if stop is None else min(stop, float(t[-1]))
    if last - first < LEAST:
        raise LogError(
            f"{log.metadata.name}: {max(last - first, 0.0):.0f} s of the log lie between "
            f"{first:g} and {last:g} s; {LEAST:g} s or more tell a noise"
        )
    return Stretch(start=first, stop=last)


def moving_time(log: DriveLog, stretch: Stretch) -> float:
    """Return for how long a car moves in a stretch, s; 0 where nothing tells.

    Args:
        log: Drive.
        stretch: Part of it.
    """
    try:
        edges, still = _still(log)
    except LogError:
        return 0.0
    inside = (edges[:-1] >= stretch.start) & (edges[1:] <= stretch.stop)
    return _STEP * float((inside & ~still).sum())


def axis_samples(log: DriveLog, axis: str, stretch: Stretch) -> tuple[FloatArray, float]:
    """Return what an axis read over a stretch, and its rate in Hz.

    Args:
        log: Drive.
        axis: Column of its IMU table.
        stretch: Where.

    Raises:
        LogError: The axis has no samples there, misses some, or always reads the same.
    """
    where = f"{log.metadata.name}: imu column {axis}"
    t, values = known_samples(log, axis)
    inside = (t >= stretch.start) & (t <= stretch.stop)
    t, values = t[inside], values[inside]
    if t.size < 2:
        raise LogError(
            f"{where} has {t.size} values from {stretch.start:g} to {stretch.stop:g} s; choose an "
            "axis and a stretch that the log has"
        )
    period = typical_period(t)
    wide = np.flatnonzero(np.diff(t) > GAP * period)
    if wide.size:
        at = int(wide[0])
        raise LogError(
            f"{where} misses samples in {wide.size} places, first for {t[at + 1] - t[at]:.3g} s "
            f"after t = {t[at]:.2f} s; an Allan variance needs all of them: choose a stretch "
            "between gaps (--from, --until)"
        )
    lost = round(float(t[-1] - t[0]) / period) + 1 - t.size
    if lost > MISSING * t.size:
        raise LogError(
            f"{where} misses {lost} of {lost + t.size} samples between {stretch.start:g} and "
            f"{stretch.stop:g} s, one here, one there; an Allan variance needs all of them"
        )
    if np.ptp(values) == 0.0:
        raise LogError(
            f"{where} reads {values[0]:g} throughout the stretch: a step coarser than the noise, "
            "or a channel that is not there; its noise cannot be told"
        )
    return values, (t.size - 1) / float(t[-1] - t[0])


def _still(log: DriveLog) -> tuple[FloatArray, BoolArray]:
    """Return ends of short intervals, and in which of them the car stands."""
    known = {axis: known_samples(log, axis) for axis in AXES}
    there = [axis for axis, (t, _) in known.items() if t.size]
    t = log.imu["t"].to_numpy(np.float64)
    edges = t[0] + np.arange(int((t[-1] - t[0]) / _STEP) + 1) * _STEP
    odometer = log.odometer
    if len(odometer) > 1:
        forces = [known[axis] for axis in ("accel_x", "accel_y") if axis in there]
        whole = tuple(values for at, values in forces if at.size == t.size)
        yaw = known["gyro_z"][1] if known["gyro_z"][0].size == t.size else None
        return edges, stationary_intervals(
            edges,
            odometer["t"].to_numpy(np.float64),
            odometer["speed"].to_numpy(np.float64),
            imu_t=t,
            yaw_rate=yaw,
            accelerations=whole,
        )
    if len(there) < len(AXES):
        raise LogError(
            f"{log.metadata.name}: without an odometer only a full IMU tells when a car stands; "
            f"this one has {', '.join(there)}: say where it stands (--from, --until)"
        )
    means = {
        axis: interval_means(*known[axis], edges, sampling=sampling_of(log, "imu")) for axis in AXES
    }
    rate, force = (np.stack([means[axis] for axis in axes], -1) for axes in (GYROS, ACCELEROMETERS))
    return edges, standstill_intervals(_STEP, rate, force)
