"""Dead reckoning as a navigator without a filter would do it: the plainest baseline.

Position of the last fix, azimuth and gyro bias by least squares of the gyro's turned angle on
the course of the last two minutes, odometer scale from all GNSS speeds so far; then the
mechanization runs alone.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.attitude import wrap_angle
from navlearn.errors import LogError
from navlearn.frames import shift_geodetic
from navlearn.states import FixTiming, GnssFix, NavState, RissSample


@dataclass(frozen=True, kw_only=True)
class DeadReckoningOptions:
    """What dead reckoning takes from the time before the outage.

    Attributes:
        window: Time over which gyro bias and azimuth are fitted to course, s.
        speed: Slowest speed at which course and scale are used, m/s.
        minimum_fixes: Fewest fixes for a bias fit; with fewer the bias at rest or zero is used.
        lever_arm: GNSS antenna from the point that navigates, body RFU, m.
    """

    window: float = 120.0
    speed: float = 3.0
    minimum_fixes: int = 20
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)


class DeadReckoningStart(NamedTuple):
    """Where dead reckoning starts.

    Attributes:
        sample: It starts at the end of this interval.
        state: Position of the last fix, azimuth of the course fit, scalars.
        gyro_bias: Gyro bias, rad/s, scalar.
        odometer_scale: Odometer scale error κ, measured = (1 + κ) true, scalar.
    """

    sample: int
    state: NavState
    gyro_bias: Tensor
    odometer_scale: Tensor


def odometer_scale_from_gnss(
    samples: RissSample, fixes: GnssFix, timing: FixTiming, speed: float
) -> Tensor:
    """Return the odometer scale error by least squares on GNSS speed.

    Args:
        samples: Intervals, shape (T,) each.
        fixes: Fixes, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        speed: Slowest odometer speed that is used, m/s.

    Returns:
        κ of measured = (1 + κ) true, scalar; zero where the car never drove fast enough.
    """
    odometer = samples.speed[timing.index.clamp(min=0)]
    use = (timing.index >= 0) & (fixes.has_velocity > 0) & (odometer > speed)
    if not bool(use.any()):
        return torch.zeros((), dtype=odometer.dtype)
    gnss = torch.hypot(fixes.v_e[use], fixes.v_n[use])
    return (odometer[use] * gnss).sum() / (gnss * gnss).sum() - 1.0


def fit_course(
    samples: RissSample, fixes: GnssFix, timing: FixTiming, options: DeadReckoningOptions
) -> tuple[Tensor, Tensor, int]:
    """Return azimuth now, gyro bias and the number of fixes that told them.

    Course = A₀ − turned angle + b t, weighted by odometer speed squared (course noise is
    σ_v / v, and a wild GNSS velocity must not weigh itself up).

    Args:
        samples: Intervals up to now, shape (T,) each.
        fixes: Fixes, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        options: Window and thresholds.

    Returns:
        Azimuth at the end of the last interval (rad), gyro bias (rad/s), fixes used.

    Raises:
        LogError: If no fix tells a course.
    """
    turned = torch.cumsum(samples.yaw_rate * samples.dt, -1)
    clock = torch.cumsum(samples.dt, -1)
    speed = torch.hypot(fixes.v_e, fixes.v_n)
    odometer = samples.speed[timing.index.clamp(min=0)]
    usable = (timing.index >= 0) & (fixes.has_velocity > 0)
    usable = usable & (torch.minimum(speed, odometer) > options.speed)
    if not bool(usable.any()):
        if not bool((fixes.has_velocity > 0).any()):
            raise LogError(
                "dead reckoning: no fix before the outage has a velocity, which a course is taken "
                "from; use a filter (ekf, tc_ekf), which is aligned by the way driven"
            )
        raise LogError(
            f"dead reckoning: no fix faster than {options.speed:g} m/s before the outage tells "
            "a course; start the outage later or lower DeadReckoningOptions.speed"
        )
    index = timing.index.clamp(min=0)
    recent = usable & (clock[index] > clock[-1] - options.window + 1e-6)
    if int(recent.sum()) < options.minimum_fixes:
        last = int(torch.nonzero(usable)[-1])
        bias = _bias_at_rest(samples, fixes.lat[last])
        at = index[last]
        azimuth = torch.atan2(fixes.v_e[last], fixes.v_n[last])
        since = clock[-1] - clock[at] + timing.delay[last]
        return azimuth - (turned[-1] - turned[at]) + bias * since, bias, 1
    at = index[recent]
    time = clock[at] - timing.delay[recent] - clock[-1]
    angle = turned[at] - samples.yaw_rate[at] * timing.delay[recent] - turned[-1]
    residual = torch.atan2(fixes.v_e[recent], fixes.v_n[recent]) + angle
    start = residual[-1]
    residual = wrap_angle(residual - start)
    weight = odometer[recent] ** 2
    slope, level = _robust_line(time, residual, weight)
    return start + level, slope, int(recent.sum())


def _robust_line(x: Tensor, y: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Return slope and level at x = 0 of a weighted line, refitted without its worst points."""
    slope, level = _line(x, y, weight)
    for _ in range(3):
        misfit = (y - slope * x - level).abs()
        scale = 1.4826 * misfit.median() + 1e-6
        slope, level = _line(x, y, weight * (misfit < 3.0 * scale))
    return slope, level


def _line(x: Tensor, y: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    total = weight.sum()
    mean_x, mean_y = (weight * x).sum() / total, (weight * y).sum() / total
    spread = (weight * (x - mean_x) ** 2).sum()
    slope = (weight * (x - mean_x) * (y - mean_y)).sum() / spread
    return slope, mean_y - slope * mean_x


def _bias_at_rest(samples: RissSample, lat: Tensor) -> Tensor:
    weight = samples.stationary * samples.dt
    time = weight.sum()
    if float(time) < 1.0:
        return torch.zeros((), dtype=weight.dtype)
    earth_rate = wgs84.EARTH_RATE * math.sin(float(lat))
    return (samples.yaw_rate * weight).sum() / time - earth_rate


def dead_reckoning_start(
    samples: RissSample, fixes: GnssFix, timing: FixTiming, options: DeadReckoningOptions
) -> DeadReckoningStart:
    """Return the state from which dead reckoning runs through an outage.

    Args:
        samples: Intervals up to the last fix and beyond, shape (T,) each.
        fixes: Fixes before the outage, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        options: Window and thresholds.

    Returns:
        Start at the interval of the last usable fix.

    Raises:
        LogError: If no fix has a position or none tells a course.
    """
    with_position = torch.nonzero((timing.index >= 0) & (fixes.has_position > 0))
    if len(with_position) == 0:
        raise LogError("dead reckoning: no fix with a position before the outage")
    m = int(with_position[-1])
    index = int(timing.index[m])
    past = RissSample(*(channel[: index + 1] for channel in samples))
    kept = timing.index <= index
    past_fixes = GnssFix(*(channel[kept] for channel in fixes))
    past_timing = FixTiming(timing.index[kept], timing.delay[kept])
    azimuth, bias, _ = fit_course(past, past_fixes, past_timing, options)
    scale = odometer_scale_from_gnss(past, past_fixes, past_timing, options.speed)
    right, forward, up = options.lever_arm
    ahead = samples.speed[index] / (1.0 + scale) * timing.delay[m] - forward
    sin, cos = torch.sin(azimuth), torch.cos(azimuth)
    lat, lon, height = shift_geodetic(
        fixes.lat[m],
        fixes.lon[m],
        fixes.height[m],
        ahead * sin - right * cos,
        ahead * cos + right * sin,
        torch.full_like(ahead, -up),
    )
    return DeadReckoningStart(index, NavState(lat, lon, height, azimuth), bias, scale)
