"""Position and receiver clock from the pseudoranges of one reception.

Gauss–Newton on weighted pseudoranges, [Groves2013] §9.4.1, for all receptions at once; one clock
for each system of satellites that is received. The residual test and exclusion are those of
:mod:`navlearn.gnss.fault_exclusion`.
"""

from enum import IntEnum
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import frames, wgs84
from navlearn.gnss.dilution import dilution
from navlearn.gnss.fault_exclusion import consistent_part
from navlearn.gnss.gauss_newton import Located, RangeProblem, linearised, located, range_problem
from navlearn.gnss.least_squares import LeastSquares, robust_factors
from navlearn.gnss.range_noise import RangeNoise, range_noise, range_variance
from navlearn.gnss.receptions import flattened
from navlearn.gnss.sight import sight
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.gnss.usable import usable_ranges, weights_of
from navlearn.states import SatelliteRanges

Place = tuple[Tensor, Tensor, Tensor]


class Reason(IntEnum):
    """Why there is no solution; the first that holds."""

    SOLVED = 0
    TOO_FEW = 1
    """Fewer satellites than unknowns: three, and one per system received."""
    GEOMETRY = 2
    """The satellites cannot tell the unknowns apart, or the PDOP is beyond the limit."""
    DIVERGED = 3
    """Gauss–Newton did not settle."""
    INCONSISTENT = 4
    """Residuals are too large, and no satellite is left to exclude."""
    IMPLAUSIBLE = 5
    """The height, or the velocity, is no car's."""


class SinglePoint(NamedTuple):
    """Positions, shape (..., M) each unless said otherwise; finite, but of use only where ``ok``.

    Attributes:
        lat: Latitude of the antenna, rad.
        lon: Longitude, rad.
        height: Height above the ellipsoid, m.
        clock: Receiver clock against the first system, m; then how far the clocks against the
            other systems are ahead of it, m; 0 where not received; shape (..., M, systems).
        clock_std: Deviation of each, m, infinite where not received, shape (..., M, systems).
        covariance: Of position east, north, up, m², shape (..., M, 3, 3).
        residual: Pseudorange minus fit, m, also of satellites not used; 0 where there is no
            range or no position; shape (..., M, S).
        used: 1.0 where the satellite took part, else 0.0, shape (..., M, S).
        excluded: 1.0 where a test took it out, else 0.0, shape (..., M, S).
        satellites: Satellites used, int64.
        test: Weighted sum of squared residuals of least squares, χ² distributed with
            ``degrees``.
        degrees: Satellites used less unknowns, int64; with 0 nothing was tested.
        ok: Whether there is a position that passed, bool.
        reason: Code of :class:`Reason`, int64.
    """

    lat: Tensor
    lon: Tensor
    height: Tensor
    clock: Tensor
    clock_std: Tensor
    covariance: Tensor
    residual: Tensor
    used: Tensor
    excluded: Tensor
    satellites: Tensor
    test: Tensor
    degrees: Tensor
    ok: Tensor
    reason: Tensor


def single_point(
    ranges: SatelliteRanges,
    options: SinglePointOptions | None = None,
    *,
    noise: RangeNoise | None = None,
    start: Place | None = None,
    systems: int | None = None,
) -> SinglePoint:
    """Return position and clock at each reception, each by itself.

    Any number of satellites will do: where they do not suffice, ``ok`` is false and ``reason``
    says why. Derivatives (to ranges, satellites and noise) are those of the last step, exact to
    residual over distance, about 1e-6; exclusions and robust weights are held.

    Args:
        ranges: Receptions, shape (..., M, S).
        options: Choices.
        noise: Noise entries in place of those of the options, so that they can be learned.
        start: Latitude, longitude (rad) and height (m) to start from, each of a shape that
            broadcasts with (..., M); the Earth's centre by default.
        systems: Number of systems of satellites, so that the clocks of parts of a drive have
            one shape; by default the largest index and one.

    Raises:
        ShapeError: The fields do not fit each other.
    """
    options = options or SinglePointOptions()
    noise = range_noise(options.noise) if noise is None else noise
    flat = flattened(ranges)
    batch = ranges.pseudorange.shape[:-1]
    usable = usable_ranges(flat, options.elevation_mask)
    variance = range_variance(noise, flat.elevation, flat.cn0, flat.std_range)
    weight = weights_of(variance, usable)
    if systems is None:
        systems = int(flat.system.max()) + 1 if flat.system.numel() else 1
    problem = range_problem(flat.satellite, flat.pseudorange, flat.system, systems)
    begin = _begin(start, batch, problem.satellite)
    with torch.no_grad():
        kept, place, passed = _searched(problem, weight.detach(), begin, options)
    weight = torch.where(kept, weight, 0.0)
    # an unsolved reception stays where it began: not in the Earth's centre, which has no latitude
    surface = torch.tensor([wgs84.SEMI_MAJOR_AXIS, 0.0, 0.0]).to(place.position)
    began = (place.position == 0.0).all(-1, keepdim=True)
    position = torch.where(began, surface, place.position)
    plain = linearised(problem, position, weight)
    robust = weight * robust_factors(plain, weight, options.huber)
    last = linearised(problem, position, robust)._replace(square=plain.square)
    found = _solution(problem, position, last, weight, flat, options.elevation_mask)
    unit = sight(found.lat, found.lon, found.height, problem.satellite).unit
    pdop = dilution(unit, found.used, flat.system).pdop
    reason = _reason(found, last, pdop, place.settled, passed, options)
    found = found._replace(reason=reason, ok=reason == Reason.SOLVED)
    return SinglePoint(*(value.reshape(*batch, *value.shape[1:]) for value in found))


def _begin(start: Place | None, batch: torch.Size, like: Tensor) -> Tensor:
    if start is None:
        return like.new_zeros(like.shape[0], 3)
    lat, lon, height = (part.to(like).expand(batch).reshape(-1) for part in start)
    return frames.ecef_from_geodetic(lat, lon, height)


def _searched(
    problem: RangeProblem, weight: Tensor, begin: Tensor, options: SinglePointOptions
) -> tuple[Tensor, Located, Tensor]:
    """Return which satellites are kept, where that leads, and whether they are consistent."""
    place = located(problem, weight, begin, options.iterations)
    position, settled = place.position.clone(), place.settled.clone()

    def solve(rows: Tensor, weight: Tensor) -> LeastSquares:
        part = RangeProblem(*(value[rows] for value in problem))
        again = located(part, weight, begin[rows], options.iterations)
        position[rows], settled[rows] = again.position, again.settled
        return linearised(part, again.position, weight)

    first = linearised(problem, position, weight)
    left = consistent_part(
        solve, weight, first, probability=options.probability, exclusions=options.exclusions
    )
    return left.weight > 0.0, Located(position, settled), left.passed


def _solution(
    problem: RangeProblem,
    position: Tensor,
    last: LeastSquares,
    weight: Tensor,
    flat: SatelliteRanges,
    mask: float,
) -> SinglePoint:
    """Return what the last step found, not yet judged."""
    solvable = last.solvable.unsqueeze(-1)
    lat, lon, height = frames.geodetic_from_ecef(position + last.estimate[:, :3])
    turn = frames.enu_from_ecef_matrix(lat, lon)
    clock, clock_variance = _against_first(last)
    used = (weight > 0.0).to(weight.dtype)
    told = (flat.has_range > 0.0) & problem.known
    return SinglePoint(
        lat=lat,
        lon=lon,
        height=height,
        clock=clock,
        clock_std=clock_variance.sqrt(),
        covariance=turn @ last.cofactor[:, :3, :3] @ turn.transpose(-1, -2),
        residual=torch.where(solvable & told, last.residual, 0.0),
        used=used,
        excluded=((flat.has_range > 0.0) & (flat.elevation >= mask)).to(used) * (1.0 - used),
        satellites=(weight > 0.0).sum(-1),
        test=torch.where(last.solvable, last.square, 0.0),
        degrees=last.degrees,
        ok=last.solvable,
        reason=torch.zeros_like(last.degrees),
    )


def _against_first(last: LeastSquares) -> tuple[Tensor, Tensor]:
    """Return the first clock, the others less the first, and their variances."""
    clock, seen = last.estimate[:, 3:], last.observed[:, 3:] & last.solvable.unsqueeze(-1)
    variance = last.cofactor.diagonal(dim1=-2, dim2=-1)[:, 3:]
    shared = last.cofactor[:, 3, 3:]
    offset = clock[:, 1:] - clock[:, :1]
    spread = variance[:, 1:] + variance[:, :1] - 2.0 * shared[:, 1:]
    both = seen[:, 1:] & seen[:, :1]
    seen = torch.cat((seen[:, :1], both), dim=-1)
    clock = torch.cat((clock[:, :1], offset), dim=-1)
    variance = torch.cat((variance[:, :1], spread), dim=-1)
    return torch.where(seen, clock, 0.0), torch.where(seen, variance, torch.inf)


def _reason(
    found: SinglePoint,
    last: LeastSquares,
    pdop: Tensor,
    settled: Tensor,
    passed: Tensor,
    options: SinglePointOptions,
) -> Tensor:
    low, high = options.heights
    reason = torch.full_like(found.reason, int(Reason.SOLVED))
    for why, holds in (
        (Reason.IMPLAUSIBLE, ~((found.height > low) & (found.height < high))),
        (Reason.INCONSISTENT, ~passed),
        (Reason.DIVERGED, ~settled),
        (Reason.GEOMETRY, ~last.solvable | ~(pdop <= options.largest_pdop)),
        (Reason.TOO_FEW, (last.degrees < 0) | ~last.observed.any(-1)),
    ):
        reason = torch.where(holds, int(why), reason)
    return reason
