"""Alignment of a car with one gyro: azimuth from GNSS course, gyro bias from standstill.

The forward axis points along the velocity of a car that does not slip or reverse, so the course
of the first fast fix is the azimuth, with the course's own uncertainty ([Noureldin2013] §6.6).
Standing still, the gyro reads its bias and the vertical Earth rate.
"""

import math
from dataclasses import dataclass, field, fields
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.errors import ConfigError, LogError
from navlearn.states import FixTiming, GnssFix, NavState, RissSample


@dataclass(frozen=True, kw_only=True)
class TrackOptions:
    """When the way driven tells azimuth, where fixes have no velocity.

    Attributes:
        azimuth_sigma: The filter starts as soon as the azimuth is known to this, rad.
        least_way: Shortest way driven that is laid onto positions, m.
        least_fixes: Fewest positions.
        least_time: Shortest time over which they are laid, s: several correlation times, as what
            errs alike within one does not show.
        longest: Longest stretch of time that is looked back over, s.
        every: How often a fit is tried, s.
        correlation_time: Time after which errors of positions have forgotten each other, s.
        scale_sigma: Standard deviation of the odometer's relative error.
        huber: Deviations from which a position counts less and less.
    """

    azimuth_sigma: float = math.radians(10.0)
    least_way: float = 20.0
    least_fixes: int = 5
    least_time: float = 30.0
    longest: float = 180.0
    every: float = 1.0
    correlation_time: float = 10.0
    scale_sigma: float = 0.03
    huber: float = 1.5

    def __post_init__(self) -> None:
        """Refuse what no way can be laid by.

        Raises:
            ConfigError: An entry lies outside its range.
        """
        for entry in fields(self):
            value = getattr(self, entry.name)
            least = 3 if entry.name == "least_fixes" else 0.0
            free = entry.name in ("least_way", "least_time", "every")
            sound = value >= least if free or least else value > least
            if not (sound and math.isfinite(value)):
                raise ConfigError(
                    f"alignment: track.{entry.name}: found {value!r}; expected "
                    f"{'3 or more' if least else '0 or more' if free else 'a number above 0'}"
                )


@dataclass(frozen=True, kw_only=True)
class AlignmentOptions:
    """How a filter is started.

    Attributes:
        speed: Slowest GNSS and odometer speed at which course is taken for azimuth, m/s.
        standstill: Shortest time at rest from which a gyro bias is taken, s.
        velocity_sigma: Standard deviation of GNSS velocity where the log has none, m/s.
        bias_sigma: Standard deviation of the gyro bias where the car never stood still, rad/s.
        bias_sigma_at_rest: Standard deviation of the gyro bias found at rest, rad/s.
        track: How azimuth is found from positions alone
            (:mod:`navlearn.mechanization.track_alignment`).
    """

    speed: float = 4.0
    standstill: float = 10.0
    velocity_sigma: float = 0.1
    bias_sigma: float = math.radians(0.5)
    bias_sigma_at_rest: float = math.radians(0.02)
    track: TrackOptions = field(default_factory=TrackOptions)


class Alignment(NamedTuple):
    """Where and with what a filter starts.

    Attributes:
        sample: The filter starts at the end of this interval.
        state: Position of the fix and azimuth from its course, scalars.
        azimuth_sigma: Standard deviation of the azimuth, rad.
        position_sigma: Horizontal standard deviation of the fix, m.
        height_sigma: Standard deviation of its height, m.
        gyro_bias: Gyro bias, rad/s; zero where it could not be seen.
        gyro_bias_sigma: Its standard deviation, rad/s.
    """

    sample: int
    state: NavState
    azimuth_sigma: float
    position_sigma: float
    height_sigma: float
    gyro_bias: float
    gyro_bias_sigma: float


def gyro_bias_at_rest(samples: RissSample, lat: Tensor, end: int) -> tuple[float, float]:
    """Return the mean gyro bias over the time at rest before a sample, and that time.

    Args:
        samples: Intervals, shape (T,) each.
        lat: Latitude, rad, scalar: the vertical Earth rate is taken off.
        end: Only intervals before this one are looked at.

    Returns:
        Bias (rad/s; 0 where the car never stood still) and time at rest (s).
    """
    weight = samples.stationary[:end] * samples.dt[:end]
    time = float(weight.sum())
    if time <= 0.0:
        return 0.0, 0.0
    mean = float((samples.yaw_rate[:end] * weight).sum()) / time
    return mean - wgs84.EARTH_RATE * math.sin(float(lat)), time


def align_from_course(
    samples: RissSample, fixes: GnssFix, timing: FixTiming, options: AlignmentOptions
) -> Alignment:
    """Return the first state from which a filter can run.

    The first fix with position and velocity at which GNSS and the odometer both say that the
    car drives forward fast enough.

    Args:
        samples: Intervals, shape (T,) each.
        fixes: Fixes, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        options: Thresholds and standard deviations.

    Returns:
        The alignment.

    Raises:
        LogError: If no fix qualifies.
    """
    ground_speed = torch.hypot(fixes.v_e, fixes.v_n)
    odometer = samples.speed[timing.index.clamp(min=0)]
    good = (
        (timing.index >= 0)
        & (fixes.has_position > 0)
        & (fixes.has_velocity > 0)
        & (ground_speed > options.speed)
        & (odometer > options.speed)
    )
    found = torch.nonzero(good)
    if len(found) == 0:
        fastest = float(ground_speed.max()) if len(ground_speed) else 0.0
        raise LogError(
            f"alignment: no fix with position and velocity at which GNSS and the odometer both "
            f"exceed {options.speed:g} m/s (fastest fix {fastest:.2f} m/s); give a stretch of "
            "driving before the first outage, or lower AlignmentOptions.speed"
        )
    m = int(found[0])
    index = int(timing.index[m])
    state = _state_at(fixes, timing, samples, m, index)
    bias, rest = gyro_bias_at_rest(samples, fixes.lat[m], index)
    enough = rest >= options.standstill
    sigma_v = max(float(fixes.std_v[m]), options.velocity_sigma)
    return Alignment(
        sample=index,
        state=state,
        azimuth_sigma=2.0 * sigma_v / float(ground_speed[m]),
        position_sigma=float(torch.maximum(fixes.std_e[m], fixes.std_n[m])),
        height_sigma=float(fixes.std_u[m]),
        gyro_bias=bias if enough else 0.0,
        gyro_bias_sigma=options.bias_sigma_at_rest if enough else options.bias_sigma,
    )


def _state_at(
    fixes: GnssFix, timing: FixTiming, samples: RissSample, m: int, index: int
) -> NavState:
    """Return the state of fix ``m`` carried over its delay to the end of interval ``index``."""
    delay = timing.delay[m]
    radius = wgs84.SEMI_MAJOR_AXIS
    lat = fixes.lat[m] + fixes.v_n[m] * delay / radius
    lon = fixes.lon[m] + fixes.v_e[m] * delay / (radius * torch.cos(fixes.lat[m]))
    course = torch.atan2(fixes.v_e[m], fixes.v_n[m])
    return NavState(lat, lon, fixes.height[m], course - samples.yaw_rate[index] * delay)
