"""Velocity and drift of the receiver's clock from the range rates of one reception.

Linear in the unknowns, [Groves2013] §9.4.1 with range rates; the term by which the Earth turns
under the signal, §8.5.3, has no part along the line of sight once satellites are in the axes of
reception. The test and exclusion of :mod:`navlearn.gnss.fault_exclusion`.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import frames
from navlearn.gnss.dilution import dilution
from navlearn.gnss.fault_exclusion import consistent_part
from navlearn.gnss.gauss_newton import out_of_the_earth
from navlearn.gnss.least_squares import LeastSquares, robust_factors, weighted_least_squares
from navlearn.gnss.range_noise import RangeNoise, range_noise, rate_variance
from navlearn.gnss.receptions import flattened
from navlearn.gnss.sight import sight
from navlearn.gnss.single_point import Place, Reason
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.gnss.usable import usable_rates, weights_of
from navlearn.states import SatelliteRanges


class RangeRateVelocity(NamedTuple):
    """Velocities, shape (..., M) each unless said otherwise; finite, of use only where ``ok``.

    Attributes:
        v_l: East, north, up, m/s, shape (..., M, 3).
        drift: Rate of the receiver clock, m/s.
        drift_std: Deviation of that, m/s.
        covariance: Of the velocity, m²/s², shape (..., M, 3, 3).
        residual: Range rate minus fit, m/s, also of satellites not used; 0 where there is no
            range rate or no velocity; shape (..., M, S).
        used: 1.0 where the satellite took part, else 0.0, shape (..., M, S).
        excluded: 1.0 where a test took it out, else 0.0, shape (..., M, S).
        satellites: Satellites used, int64.
        test: Weighted sum of squared residuals of least squares, χ² distributed with
            ``degrees``.
        degrees: Satellites used less four, int64; with 0 nothing was tested.
        ok: Whether there is a velocity that passed, bool.
        reason: Code of :class:`navlearn.gnss.single_point.Reason`, int64.
    """

    v_l: Tensor
    drift: Tensor
    drift_std: Tensor
    covariance: Tensor
    residual: Tensor
    used: Tensor
    excluded: Tensor
    satellites: Tensor
    test: Tensor
    degrees: Tensor
    ok: Tensor
    reason: Tensor


def range_rate_velocity(
    ranges: SatelliteRanges,
    place: Place,
    options: SinglePointOptions | None = None,
    *,
    noise: RangeNoise | None = None,
) -> RangeRateVelocity:
    """Return velocity and clock drift at each reception, each by itself.

    Four satellites are needed, of whatever systems: their times run at one rate.

    Args:
        ranges: Receptions, shape (..., M, S).
        place: Latitude, longitude (rad) and height (m) of the antenna, each of a shape that
            broadcasts with (..., M); 100 m off cost 2 cm/s.
        options: Choices.
        noise: Noise entries in place of those of the options, so that they can be learned.

    Raises:
        ShapeError: The fields do not fit each other.
    """
    options = options or SinglePointOptions()
    noise = range_noise(options.noise) if noise is None else noise
    flat = flattened(ranges)
    batch = ranges.pseudorange.shape[:-1]
    usable = usable_rates(flat, options.elevation_mask)
    variance = rate_variance(noise, flat.elevation, flat.cn0, flat.std_rate)
    unit, own_rate = _sights(flat, place, batch)
    known = torch.isfinite(flat.range_rate + own_rate)
    weight = weights_of(variance, usable & known)
    observation = torch.where(known, flat.range_rate - own_rate, 0.0)
    unit = torch.where(torch.isfinite(own_rate).unsqueeze(-1), unit, 0.0)
    design = torch.cat((-unit, torch.ones_like(unit[..., :1])), dim=-1)
    with torch.no_grad():
        kept, passed = _searched(design, observation, weight.detach(), options)
    weight = torch.where(kept, weight, 0.0)
    plain = weighted_least_squares(design, observation, weight)
    robust = weight * robust_factors(plain, weight, options.huber)
    last = weighted_least_squares(design, observation, robust)._replace(square=plain.square)
    pdop = dilution(unit, weight > 0.0).pdop
    found = _solution(last, flat, weight, options, known)
    reason = _reason(found, last, pdop, passed, options)
    found = found._replace(reason=reason, ok=reason == Reason.SOLVED)
    return RangeRateVelocity(*(value.reshape(*batch, *value.shape[1:]) for value in found))


def _sights(flat: SatelliteRanges, place: Place, batch: torch.Size) -> tuple[Tensor, Tensor]:
    """Return unit vectors (ENU), and how fast the satellites themselves move apart."""
    satellite, _ = out_of_the_earth(flat.satellite)
    lat, lon, height = (part.to(satellite).expand(batch).reshape(-1) for part in place)
    unit = sight(lat, lon, height, satellite).unit
    turn = frames.enu_from_ecef_matrix(lat, lon)
    velocity = torch.matmul(flat.satellite_velocity, turn.transpose(-1, -2))
    return unit, (unit * velocity).sum(-1)


def _searched(
    design: Tensor, observation: Tensor, weight: Tensor, options: SinglePointOptions
) -> tuple[Tensor, Tensor]:
    """Return which satellites are kept, and whether they are consistent."""

    def solve(rows: Tensor, weight: Tensor) -> LeastSquares:
        return weighted_least_squares(design[rows], observation[rows], weight)

    left = consistent_part(
        solve,
        weight,
        weighted_least_squares(design, observation, weight),
        probability=options.probability,
        exclusions=options.exclusions,
    )
    return left.weight > 0.0, left.passed


def _solution(
    last: LeastSquares,
    flat: SatelliteRanges,
    weight: Tensor,
    options: SinglePointOptions,
    known: Tensor,
) -> RangeRateVelocity:
    """Return the fit, not yet judged."""
    used = (weight > 0.0).to(weight.dtype)
    told = flat.has_rate > 0.0
    drift_variance = torch.where(last.solvable, last.cofactor[:, 3, 3], torch.inf)
    return RangeRateVelocity(
        v_l=last.estimate[:, :3],
        drift=last.estimate[:, 3],
        drift_std=drift_variance.sqrt(),
        covariance=last.cofactor[:, :3, :3],
        residual=torch.where(last.solvable.unsqueeze(-1) & told & known, last.residual, 0.0),
        used=used,
        excluded=(told & (flat.elevation >= options.elevation_mask)).to(used) * (1.0 - used),
        satellites=(weight > 0.0).sum(-1),
        test=torch.where(last.solvable, last.square, 0.0),
        degrees=last.degrees,
        ok=last.solvable,
        reason=torch.zeros_like(last.degrees),
    )


def _reason(
    found: RangeRateVelocity,
    last: LeastSquares,
    pdop: Tensor,
    passed: Tensor,
    options: SinglePointOptions,
) -> Tensor:
    speed = torch.linalg.vector_norm(found.v_l, dim=-1)
    reason = torch.full_like(found.reason, int(Reason.SOLVED))
    for why, holds in (
        (Reason.IMPLAUSIBLE, ~(speed < options.fastest)),
        (Reason.INCONSISTENT, ~passed),
        (Reason.GEOMETRY, ~last.solvable | ~(pdop <= options.largest_pdop)),
        (Reason.TOO_FEW, (last.degrees < 0) | ~last.observed.any(-1)),
    ):
        reason = torch.where(holds, int(why), reason)
    return reason
