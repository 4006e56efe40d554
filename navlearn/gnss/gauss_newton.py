"""Gauss–Newton on pseudoranges, in Earth-fixed axes, for many receptions at once.

Source: [Groves2013] §9.4.1. The clocks are linear in the ranges and are solved for anew at every
step, so that a jump of the receiver's clock costs nothing.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.gnss.least_squares import LeastSquares, weighted_least_squares

_CONVERGED = 1e-4
"""A step shorter than this is the last, m."""

_FARTHEST = 1e9
"""A position farther out than this has run away, m."""


class RangeProblem(NamedTuple):
    """Ranges of N receptions; what makes no sense stands somewhere harmless.

    Attributes:
        satellite: Satellites in axes of reception, m, shape (N, S, 3).
        pseudorange: Pseudoranges, m, shape (N, S).
        clocks: 1.0 at the system of each satellite, shape (N, S, systems).
        known: Which stand where they were said to be, bool, shape (N, S).
    """

    satellite: Tensor
    pseudorange: Tensor
    clocks: Tensor
    known: Tensor


class Located(NamedTuple):
    """Where Gauss–Newton arrived.

    Attributes:
        position: Antenna in Earth-fixed axes, m, shape (N, 3).
        settled: Whether the last step was short, bool, shape (N,).
    """

    position: Tensor
    settled: Tensor


def range_problem(
    satellite: Tensor, pseudorange: Tensor, system: Tensor, systems: int
) -> RangeProblem:
    """Return the problem with what is not finite, or in no orbit, replaced.

    Args:
        satellite: Satellites, m, shape (N, S, 3).
        pseudorange: Pseudoranges, m, shape (N, S).
        system: Index of each satellite's system, int64, shape (N, S).
        systems: Number of systems.
    """
    satellite, known = out_of_the_earth(satellite)
    known = known & torch.isfinite(pseudorange)
    index = torch.arange(systems, device=system.device)
    return RangeProblem(
        satellite=satellite,
        pseudorange=torch.where(known, pseudorange, 0.0),
        clocks=(system.unsqueeze(-1) == index).to(satellite.dtype),
        known=known,
    )


def out_of_the_earth(satellite: Tensor) -> tuple[Tensor, Tensor]:
    """Return satellites with those that are nowhere put over the pole, and which were somewhere.

    Args:
        satellite: Satellites, m, shape (..., 3).

    Returns:
        Satellites, shape (..., 3), and a mask, bool, shape (...).
    """
    distance = torch.linalg.vector_norm(satellite, dim=-1)
    known = (distance > wgs84.SEMI_MAJOR_AXIS) & torch.isfinite(distance)
    aloft = torch.tensor([0.0, 0.0, 4.0 * wgs84.SEMI_MAJOR_AXIS]).to(satellite)
    return torch.where(known.unsqueeze(-1), satellite, aloft), known


def linearised(problem: RangeProblem, position: Tensor, weight: Tensor) -> LeastSquares:
    """Solve the problem linearised at a position: the step (ECEF, m), then the clocks (m).

    Args:
        problem: Ranges.
        position: Where to linearise, m, shape (N, 3).
        weight: Inverse variances, shape (N, S).
    """
    away = problem.satellite - position.unsqueeze(-2)
    distance = torch.sqrt((away * away).sum(-1)).clamp_min(1.0)
    design = torch.cat((-away / distance.unsqueeze(-1), problem.clocks), dim=-1)
    return weighted_least_squares(design, problem.pseudorange - distance, weight)


def located(problem: RangeProblem, weight: Tensor, start: Tensor, iterations: int) -> Located:
    """Iterate from a start until every reception has settled.

    Args:
        problem: Ranges.
        weight: Inverse variances, shape (N, S).
        start: Where to start, m, shape (N, 3).
        iterations: Most steps.
    """
    position, settled = start, torch.zeros(weight.shape[0], dtype=torch.bool, device=weight.device)
    for _ in range(iterations):
        found = linearised(problem, position, weight)
        step = found.estimate[:, :3]
        position = position + step
        lost = ~(torch.linalg.vector_norm(position, dim=-1) < _FARTHEST)
        position = torch.where(lost.unsqueeze(-1), start, position)
        settled = (torch.linalg.vector_norm(step, dim=-1) < _CONVERGED) & ~lost
        if bool(settled.all()):
            break
    return Located(position, settled)
