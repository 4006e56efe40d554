"""Are the ranges of a reception consistent, and if not, which one is not?

The global test of the weighted squares, then the largest normalised residual, is the detection
and identification of [Baarda1968], as receiver autonomous integrity monitoring has it:
[Groves2013] §17.4.1. One satellite goes at a time, and everything is solved anew.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.consistency import chi_square_quantile
from navlearn.gnss.least_squares import LeastSquares


class Consistent(NamedTuple):
    """What the test left, for N receptions.

    Attributes:
        weight: Weights with those of excluded satellites at zero, shape (N, S).
        passed: Whether the rest is consistent; true also where nothing can be tested, bool,
            shape (N,).
    """

    weight: Tensor
    passed: Tensor


Solve = Callable[[Tensor, Tensor], LeastSquares]
"""Solves receptions: takes their rows, int64, shape (n,), and weights, shape (n, S)."""


def consistent_part(
    solve: Solve, weight: Tensor, first: LeastSquares, *, probability: float, exclusions: int
) -> Consistent:
    """Exclude outlying satellites until the rest is consistent.

    While a reception fails the χ² test and has two observations to spare, its satellite with the
    largest normalised residual goes; with one to spare a fault is seen but not to be found.

    Args:
        solve: Solves a choice of receptions with given weights.
        weight: Inverse variances, shape (N, S).
        first: Solution with these weights.
        probability: Share of sound receptions that pass the test.
        exclusions: Most satellites that may go.
    """
    weight, square, degrees = weight.clone(), first.square.clone(), first.degrees.clone()
    solvable, normalised = first.solvable.clone(), first.normalised.clone()
    limit = limits(probability, weight.shape[-1]).to(weight.device)
    for _ in range(exclusions):
        failed = solvable & (square > limit[degrees.clamp_min(0)])
        rows = torch.nonzero(failed & (degrees >= 2)).squeeze(-1)
        if rows.numel() == 0:
            break
        worst = normalised[rows].abs().argmax(-1)
        weight[rows, worst] = 0.0
        again = solve(rows, weight[rows])
        square[rows], degrees[rows] = again.square, again.degrees
        solvable[rows], normalised[rows] = again.solvable, again.normalised
    return Consistent(weight, solvable & (square <= limit[degrees.clamp_min(0)]))


@lru_cache(maxsize=32)
def limits(probability: float, most: int) -> Tensor:
    """Return the largest sum of squares that passes, by degrees of freedom.

    Args:
        probability: Share of sound receptions that pass.
        most: Largest number of degrees of freedom.

    Returns:
        Limits for 0 to ``most`` degrees, infinite for 0, shape (most + 1,).
    """
    values = [chi_square_quantile(probability, float(n)) for n in range(1, most + 1)]
    return torch.tensor([float("inf"), *values], dtype=torch.float64)
