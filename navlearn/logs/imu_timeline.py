"""From the tables of a drive to the uniform tensors that a full-IMU filter takes.

All six axes become means over the intervals of a uniform grid: what a strapdown integrates is
exactly what the sensors told, whatever jitter their stamps have. A sample that holds at an instant
shares in the two intervals beside it, so a value looks ahead to the end of its interval and one
IMU sample at most; the odometer's straight lines look ahead one odometer sample. No fix reaches a
sensor value, and no fix an earlier fix.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from navlearn.errors import ConfigError, LogError
from navlearn.logs.clock import without_latency
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.fix_tensors import FixOptions, fixes_from_table
from navlearn.logs.imu_means import imu_mean, sampling_of
from navlearn.logs.ins_standstill import BoolArray, InsStandstillOptions, standstill_intervals
from navlearn.logs.interval_means import FloatArray, interval_means, typical_period
from navlearn.logs.six_axes import ACCELEROMETERS, GYROS, check_six_axes
from navlearn.states import FixTiming, GnssFix, ImuSample


@dataclass(frozen=True, kw_only=True)
class ImuTimelineOptions:
    """How a drive becomes a full-IMU timeline.

    Attributes:
        max_imu_gap: Longest gap in the IMU that a straight line may bridge, s. A strapdown knows
            nothing of what the car did there: a second in a turn costs a degree of azimuth.
        max_odometer_gap: Longest gap in the odometer that a straight line may bridge, s; in a
            longer one the odometer tells nothing.
        fixes: What is assumed where fixes do not tell their own standard deviations.
        standstill: What counts as standing still.
    """

    max_imu_gap: float = 0.5
    max_odometer_gap: float = 3.5
    fixes: FixOptions = field(default_factory=FixOptions)
    standstill: InsStandstillOptions = field(default_factory=InsStandstillOptions)


@dataclass(frozen=True, kw_only=True)
class ImuTimeline:
    """One drive on a uniform grid; float64 unless said otherwise.

    Attributes:
        start_time: Begin of the first interval, s.
        t: End of every interval, s, shape (T,).
        samples: Interval means, shape (T,) or (T, 3) each.
        fixes: GNSS solutions on the grid, shape (M,) each.
        timing: Interval at whose end each fix is used, and its delay, shape (M,) each.
        fix_time: When each fix was valid, s, shape (M,).
        bridged: Where a gap in the IMU was bridged by a straight line, bool, shape (T,).
    """

    start_time: float
    t: Tensor
    samples: ImuSample
    fixes: GnssFix
    timing: FixTiming
    fix_time: Tensor
    bridged: Tensor


def imu_timeline(
    log: DriveLog, *, rate_hz: float | None = None, options: ImuTimelineOptions | None = None
) -> ImuTimeline:
    """Return a drive's full IMU as interval means on a uniform grid, with its fixes beside.

    The grid covers the IMU. Latencies that the log's metadata state and that are still in the
    times are removed. A fix is used at the end of the nearest interval; fixes outside the grid are
    left out. An odometer is not needed; where it tells a speed, ``has_speed`` is 1.

    Args:
        log: Drive.
        rate_hz: Intervals per second; None keeps the IMU's own rate. A lower one loses coning
            and sculling.
        options: Limits and assumptions.

    Returns:
        The drive's timeline.

    Raises:
        ConfigError: ``rate_hz`` is not positive.
        LogError: An axis is missing or has a gap longer than may be bridged, the gyros are not in
            rad/s, or the accelerometers do not tell gravity along z.
    """
    chosen = options or ImuTimelineOptions()
    log = without_latency(log)
    check_six_axes(log)
    edges = _grid(log, rate_hz)
    samples, bridged = _samples(log, edges, chosen)
    fixes, timing, fix_time = fixes_from_table(log.fixes, edges, chosen.fixes)
    return ImuTimeline(
        start_time=float(edges[0]),
        t=torch.tensor(edges[1:]),
        samples=samples,
        fixes=fixes,
        timing=timing,
        fix_time=fix_time,
        bridged=torch.tensor(bridged),
    )


def _grid(log: DriveLog, rate_hz: float | None) -> FloatArray:
    t = log.imu["t"].to_numpy(np.float64)
    period = typical_period(t)
    if rate_hz is not None and not (rate_hz > 0.0 and np.isfinite(rate_hz)):
        raise ConfigError(
            f"rate_hz: found {rate_hz}; give a positive number of intervals per s, or None for "
            "the IMU's own rate"
        )
    rate = 1.0 / period if rate_hz is None else rate_hz
    start = float(t[0]) - (period if sampling_of(log, "imu") == "interval" else 0.0)
    count = int(np.floor((float(t[-1]) - start) * rate + 1e-3))
    if count < 1:
        raise LogError(
            f"{log.metadata.name}: IMU covers {start:.3f} to {t[-1]:.3f} s, not one interval of "
            f"{1.0 / rate:g} s; give a longer drive or a higher rate_hz"
        )
    return start + np.arange(count + 1) / rate


def _samples(
    log: DriveLog, edges: FloatArray, options: ImuTimelineOptions
) -> tuple[ImuSample, BoolArray]:
    rate, force = (
        np.stack([imu_mean(log, axis, edges, options.max_imu_gap) for axis in axes], axis=-1)
        for axes in (GYROS, ACCELEROMETERS)
    )
    bridged = _bridged(log, edges)
    speed, told = _speed(log, edges, options.max_odometer_gap)
    still = standstill_intervals(
        float(edges[1] - edges[0]),
        rate,
        force,
        measured=~bridged,
        speed=speed,
        has_speed=told,
        options=options.standstill,
    )
    channels = (np.diff(edges), rate, force, speed, told.astype(float), still.astype(float))
    return ImuSample(*(torch.tensor(channel) for channel in channels)), bridged


def _bridged(log: DriveLog, edges: FloatArray) -> BoolArray:
    """Return the intervals that a gap of more than two missing samples touches."""
    t = log.imu["t"].to_numpy(np.float64)
    wide = np.flatnonzero(np.diff(t) > 3.5 * typical_period(t))
    change = np.zeros(edges.size + 1, dtype=np.int64)
    np.add.at(change, np.searchsorted(edges[1:], t[wide], side="right"), 1)
    np.add.at(change, np.searchsorted(edges[:-1], t[wide + 1], side="left"), -1)
    touched: BoolArray = np.cumsum(change)[: edges.size - 1] > 0
    return touched


def _speed(log: DriveLog, edges: FloatArray, limit: float) -> tuple[FloatArray, BoolArray]:
    """Return mean odometer speed, zero where it was not told, and where it was."""
    t = log.odometer["t"].to_numpy(np.float64)
    if t.size < 2:
        return np.zeros(edges.size - 1), np.zeros(edges.size - 1, dtype=np.bool_)
    speed = log.odometer["speed"].to_numpy(np.float64)
    sampling = sampling_of(log, "odometer")
    begin = t[0] - (typical_period(t) if sampling == "interval" else 0.0)
    wide = np.diff(t) > limit
    # The sample before an interval's begin, and the one at or after its end.
    left = np.clip(np.searchsorted(t, edges[:-1] + 1e-9, side="right") - 1, 0, t.size - 2)
    right = np.clip(np.searchsorted(t, edges[1:] - 1e-9, side="left") - 1, 0, t.size - 2)
    inside = (edges[:-1] >= begin - 1e-9) & (edges[1:] <= t[-1] + 1e-9)
    gaps = np.concatenate(([0], np.cumsum(wide)))
    told: BoolArray = inside & (gaps[right + 1] == gaps[left])
    means = interval_means(t, speed, edges, sampling=sampling)
    return np.where(told, means, 0.0), told
