"""What ranges and range rates say of a vehicle and a clock: innovation, H and R.

A pseudorange is the way from the satellite, where it sent, to the antenna, where it received, in
axes of the moment of reception, plus the clock [Groves2013] §14.3.2; its rate is the change
of that way per second of reception. With u the unit vector from the antenna, velocities against
the Earth and ω its rotation, the rate is u·(v_s − v_a) / (1 + u·(v_s + ω × r_s)/c): the part
through which the Earth turns satellite and antenna together, u·(ω × (r_s − r_a)), vanishes, and the
denominator is what the signal's travel time changes meanwhile (up to 3 mm/s). Neglected are
products of the clock's drift with the rate (0.8 mm/s at 1 ppm), and in H the turning of east, north
and up with the place (5e-6 m/s per m).
"""

import torch
from torch import Tensor

from navlearn import earth, wgs84
from navlearn.frames import enu_from_ecef_matrix
from navlearn.fusion.measured import Measured
from navlearn.fusion.tight.clock import BIAS, DRIFT
from navlearn.fusion.tight.model import SURPRISES
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.timeline import Reception
from navlearn.fusion.tight.vehicle import Antenna
from navlearn.gnss.range_noise import range_variance, rate_variance
from navlearn.gnss.sight import Sight, sight
from navlearn.gnss.signals import SPEED_OF_LIGHT
from navlearn.states import SatelliteRanges


def measured_ranges(
    antenna: Antenna, clock: Tensor, reception: Reception, noise: TightNoise
) -> Measured:
    """Return innovation, H and R of all pseudoranges, then of all range rates.

    The columns of H are the vehicle's n states, the c clock states, and three for what the
    antenna's velocity does beside the states, whose variance is ``antenna.velocity_variance``.

    Args:
        antenna: Where the antenna was at the reception, shape (...).
        clock: Clock states at the block's end, shape (..., c).
        reception: What was received, shape (...).
        noise: Noise of ranges.

    Returns:
        Innovations, shape (..., 2 S); what is not measured has none, no H and unit variance.
    """
    ranges = reception.ranges
    seen = sight(antenna.lat, antenna.lon, antenna.height, ranges.satellite)
    by_clock = _clock_columns(ranges.system, clock.shape[-1], reception.delay)
    predicted = seen.distance + _times(by_clock, clock)
    by_position = -seen.unit
    nothing = torch.zeros_like(by_position)
    range_rows = torch.cat((by_position @ antenna.position_by_error, by_clock, nothing), -1)
    rate, by_place, by_velocity = _rates(antenna, seen, ranges)
    drift = clock[..., DRIFT].unsqueeze(-1)
    by_drift = torch.zeros_like(by_clock)
    by_drift[..., DRIFT] = 1.0
    by_state = by_place @ antenna.position_by_error + by_velocity @ antenna.velocity_by_error
    rate_rows = torch.cat((by_state, by_drift, by_velocity), -1)
    there = torch.cat((ranges.has_range, ranges.has_rate), -1)
    use = there > 0.5
    innovation = torch.cat((ranges.pseudorange - predicted, ranges.range_rate - rate - drift), -1)
    variance = torch.cat(
        (
            range_variance(noise.range, ranges.elevation, ranges.cn0, ranges.std_range),
            rate_variance(noise.range, ranges.elevation, ranges.cn0, ranges.std_rate),
        ),
        -1,
    )
    return Measured(
        torch.where(use, innovation, 0.0),
        torch.where(use.unsqueeze(-1), torch.cat((range_rows, rate_rows), -2), 0.0),
        torch.where(use, variance, 1.0),
        there,
    )


def variance_in_series(found: Measured, reception: Reception, noise: TightNoise) -> Tensor:
    """Return the variances with which measurements count for the state, multipath being repeated.

    Whether a measurement is believed is asked of it by itself, by ``found.variance``: a reflection
    that lasts is as wild as one that does not. What it tells is less than if it were independent.

    Args:
        found: What ranges say, shape (..., 2 S).
        reception: What was received, shape (...).
        noise: Noise of ranges.

    Returns:
        Shape (..., 2 S).
    """
    ranges, since = reception.ranges, reception.since.unsqueeze(-1)
    series = range_variance(noise.range, ranges.elevation, ranges.cn0, ranges.std_range, since)
    count = series.shape[-1]
    there = found.present[..., :count] > 0.5
    return torch.cat((torch.where(there, series, 1.0), found.variance[..., count:]), -1)


def with_surprise(covariance: Tensor, antenna: Antenna) -> Tensor:
    """Return a covariance with that of the antenna's velocity beside the states below it.

    Args:
        covariance: P, shape (..., n + c, n + c).
        antenna: The antenna, shape (...).

    Returns:
        Shape (..., n + c + 3, n + c + 3).
    """
    size = covariance.shape[-1]
    wide = torch.nn.functional.pad(covariance, (0, SURPRISES, 0, SURPRISES))
    surprise = torch.diag_embed(antenna.velocity_variance)
    return wide + torch.nn.functional.pad(surprise, (size, 0, size, 0))


def _clock_columns(system: Tensor, count: int, delay: Tensor) -> Tensor:
    """Return the derivative of pseudoranges by the clock states, shape (..., S, c)."""
    place = torch.where(system > 0, system + DRIFT, BIAS).unsqueeze(-1)
    own = (place == torch.arange(count, device=system.device)).to(delay)
    back = torch.zeros_like(own)
    back[..., BIAS] = 1.0
    # the further systems' satellites show the bias beside their offset
    columns = torch.maximum(own, back)
    before = torch.zeros_like(own)
    before[..., DRIFT] = 1.0
    return columns - delay[..., None, None] * before


def _rates(antenna: Antenna, seen: Sight, ranges: SatelliteRanges) -> tuple[Tensor, Tensor, Tensor]:
    """Return rates of distances, and their derivatives by the antenna's place and velocity.

    Shapes (..., S), (..., S, 3) and (..., S, 3).
    """
    turn = enu_from_ecef_matrix(antenna.lat, antenna.lon)
    moving = ranges.satellite_velocity @ turn.transpose(-1, -2)
    apart = moving - antenna.velocity.unsqueeze(-2)
    along = (seen.unit * apart).sum(-1)
    # u·(ω × r_s) = u·(ω × r_a), and that is how fast the Earth carries the antenna eastwards
    radius = earth.prime_vertical_radius(antenna.lat) + antenna.height
    carried = wgs84.EARTH_RATE * radius * torch.cos(antenna.lat)
    towards = (seen.unit * moving).sum(-1) + seen.unit[..., 0] * carried.unsqueeze(-1)
    slower = 1.0 / (1.0 + towards / SPEED_OF_LIGHT)
    across = apart - along.unsqueeze(-1) * seen.unit
    by_place = -across * (slower / seen.distance).unsqueeze(-1)
    return along * slower, by_place, -seen.unit * slower.unsqueeze(-1)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
