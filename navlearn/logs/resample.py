"""From the tables of a drive to the uniform tensors that the filters take.

Sensor values become means over the intervals of a uniform grid. The 1 or 2 Hz odometer is
integrated as straight lines between its samples, so a value may depend on the odometer sample
that follows it: one sample of look-ahead, which an odometer stamped late needs anyway. No fix
reaches a sensor value, and no fix an earlier fix.
"""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from navlearn import earth
from navlearn.errors import ConfigError, LogError
from navlearn.logs.clock import without_latency
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.fix_tensors import FixOptions, fixes_from_table
from navlearn.logs.imu_means import imu_mean, sampling_of
from navlearn.logs.interval_means import (
    FloatArray,
    interval_means,
    longest_gap,
    typical_period,
)
from navlearn.logs.stationary import StationaryOptions, stationary_intervals
from navlearn.mechanization.tilt import TiltOptions, tilt_from_specific_force
from navlearn.states import FixTiming, GnssFix, RissSample


@dataclass(frozen=True, kw_only=True)
class ResampleOptions:
    """How a drive becomes a timeline.

    Attributes:
        max_imu_gap: Longest gap in the IMU that a straight line may bridge, s.
        max_odometer_gap: Longest gap in the odometer that a straight line may bridge, s.
        max_odometer_hold: Longest time for which the last speed is held where the odometer ends
            before the IMU, as it does when a drive is cut between its samples, s.
        fixes: What is assumed where fixes do not tell their own standard deviations.
        stationary: What counts as standing still.
        tilt: How pitch and roll are found for 3D.
    """

    max_imu_gap: float = 0.5
    max_odometer_gap: float = 3.5
    max_odometer_hold: float = 1.5
    fixes: FixOptions = field(default_factory=FixOptions)
    stationary: StationaryOptions = field(default_factory=StationaryOptions)
    tilt: TiltOptions = field(default_factory=TiltOptions)


@dataclass(frozen=True, kw_only=True)
class RissTimeline:
    """One drive on a uniform grid; float64 unless said otherwise.

    Attributes:
        start_time: Begin of the first interval, s.
        t: End of every interval, s, shape (T,).
        samples: Interval means, shape (T,) each.
        fixes: GNSS solutions on the grid, shape (M,) each.
        timing: Interval at whose end each fix is used, and its delay, shape (M,) each.
        fix_time: When each fix was valid, s, shape (M,).
    """

    start_time: float
    t: Tensor
    samples: RissSample
    fixes: GnssFix
    timing: FixTiming
    fix_time: Tensor


def riss_timeline(
    log: DriveLog, *, rate_hz: float, dims: int = 2, options: ResampleOptions | None = None
) -> RissTimeline:
    """Return a drive as interval means on a uniform grid, with its fixes beside.

    The grid begins where IMU and odometer both have begun and ends with the IMU, or where the
    odometer has been silent too long to be held. Latencies that the log's metadata state and
    that are still in the times are removed. A fix is used at the end of the nearest interval;
    fixes outside the grid are left out.

    Args:
        log: Drive.
        rate_hz: Intervals per second.
        dims: 2 for level driving; 3 to add pitch and roll from the accelerometers.
        options: Limits and assumptions.

    Returns:
        The drive's timeline.

    Raises:
        ConfigError: ``rate_hz`` is not positive or ``dims`` is neither 2 nor 3.
        LogError: A stream has a gap longer than may be bridged, the streams do not overlap,
            or 3D is asked of a log without horizontal specific force.
    """
    if not (rate_hz > 0.0 and np.isfinite(rate_hz)):
        raise ConfigError(f"rate_hz: found {rate_hz}; give a positive number of intervals per s")
    if dims not in (2, 3):
        raise ConfigError(f"dims: found {dims}; give 2 (level) or 3 (with pitch and roll)")
    chosen = options or ResampleOptions()
    log = without_latency(log)
    edges = _grid(log, rate_hz, chosen.max_odometer_hold)
    _refuse_odometer_gap(log, edges, chosen.max_odometer_gap)
    samples = _samples(log, edges, chosen)
    if dims == 3:
        samples = _with_tilt(samples, log, chosen.tilt)
    fixes, timing, fix_time = fixes_from_table(log.fixes, edges, chosen.fixes)
    return RissTimeline(
        start_time=float(edges[0]),
        t=torch.tensor(edges[1:]),
        samples=samples,
        fixes=fixes,
        timing=timing,
        fix_time=fix_time,
    )


def _span(log: DriveLog, name: str, table: pd.DataFrame) -> tuple[float, float]:
    t = table["t"].to_numpy(np.float64)
    if t.size == 0:
        remedy = (
            "a single gyro navigates only with an odometer; use a log with wheel or OBD-II speed, "
            "or all six axes of the IMU (imu_timeline, mechanization.sensors: imu)"
            if name == "odometer"
            else "there is nothing to resample"
        )
        raise LogError(f"{log.metadata.name}: {name} has no rows; {remedy}")
    lead = typical_period(t) if sampling_of(log, name) == "interval" else 0.0
    return float(t[0]) - lead, float(t[-1])


def _grid(log: DriveLog, rate_hz: float, hold: float) -> FloatArray:
    spans = [_span(log, "imu", log.imu), _span(log, "odometer", log.odometer)]
    start, stop = max(begin for begin, _ in spans), min(spans[0][1], spans[1][1] + hold)
    count = int(np.floor((stop - start) * rate_hz + 1e-6))
    if count < 1:
        raise LogError(
            f"{log.metadata.name}: IMU covers {spans[0][0]:.2f} to {spans[0][1]:.2f} s, odometer "
            f"{spans[1][0]:.2f} to {spans[1][1]:.2f} s, with no whole interval of "
            f"{1.0 / rate_hz:g} s in common; check that both use the same clock"
        )
    return start + np.arange(count + 1) / rate_hz


def _refuse_odometer_gap(log: DriveLog, edges: FloatArray, limit: float) -> None:
    t = log.odometer["t"].to_numpy(np.float64)
    start, length = longest_gap(t, float(edges[0]), float(edges[-1]))
    if length > limit:
        raise LogError(
            f"{log.metadata.name}: odometer has no sample for {length:.2f} s after t = "
            f"{start:.2f} s, more than the {limit:g} s that may be bridged; cut the log there "
            "(DriveLog.between) or raise max_odometer_gap"
        )


def _samples(log: DriveLog, edges: FloatArray, options: ResampleOptions) -> RissSample:
    imu_t = log.imu["t"].to_numpy(np.float64)
    odometer_t = log.odometer["t"].to_numpy(np.float64)
    speed = log.odometer["speed"].to_numpy(np.float64)
    zero = np.zeros(edges.size - 1)

    def mean(column: str) -> FloatArray:
        return imu_mean(log, column, edges, options.max_imu_gap)

    still = stationary_intervals(
        edges,
        odometer_t,
        speed,
        imu_t=imu_t,
        yaw_rate=log.imu["gyro_z"].to_numpy(np.float64),
        accelerations=tuple(
            log.imu[name].to_numpy(np.float64)
            for name in ("accel_x", "accel_y")
            if name in log.imu and log.imu[name].notna().all()
        ),
        options=options.stationary,
    )
    speed_mean = interval_means(odometer_t, speed, edges, sampling=sampling_of(log, "odometer"))
    channels = (
        np.diff(edges),
        mean("gyro_z"),
        speed_mean,
        zero,
        zero,
        mean("accel_x"),
        mean("accel_y"),
        still.astype(np.float64),
    )
    return RissSample(*(torch.tensor(channel) for channel in channels))


def _with_tilt(samples: RissSample, log: DriveLog, options: TiltOptions) -> RissSample:
    missing = [name for name in ("accel_x", "accel_y") if name not in log.imu]
    if missing:
        raise LogError(
            f"{log.metadata.name}: imu has no {' and no '.join(missing)}, which dims=3 needs for "
            "pitch and roll; use dims=2 or a log with accelerometers"
        )
    known = log.fixes["lat"].dropna()
    if known.empty:
        raise LogError(f"{log.metadata.name}: no fix has a position; dims=3 needs one for gravity")
    lat = torch.tensor(float(known.iloc[0]), dtype=torch.float64)
    gravity = earth.normal_gravity(lat, torch.zeros_like(lat))
    tilt = tilt_from_specific_force(
        samples.f_y,
        samples.f_x,
        samples.speed,
        samples.yaw_rate,
        samples.dt,
        gravity,
        options,
    )
    return samples._replace(pitch=tilt.pitch, roll=tilt.roll)
