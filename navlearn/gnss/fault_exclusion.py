"""Are the ranges of a reception consistent, and if not, which of them are not?

The global test of the weighted squares, then the satellite whose absence lowers them most, which
has the largest normalised residual: detection and identification of [Baarda1968], as receiver
autonomous integrity monitoring has it, [Groves2013] §17.4.1. Where no single one will do, the
pair whose absence lowers the squares most is tried too: of two faults each hides the other.
Everything is solved anew after an exclusion.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.consistency import chi_square_quantile
from navlearn.gnss.least_squares import LeastSquares

_SEPARABLE = 1e-6
"""Least determinant of the redundancy of two observations whose faults can be told apart."""


class Consistent(NamedTuple):
    """What the test left, for N receptions.

    Attributes:
        weight: Weights with those of excluded satellites at zero, shape (N, S).
        passed: Whether the rest is consistent; true also where nothing can be tested, bool,
            shape (N,).
    """

    weight: Tensor
    passed: Tensor


class _Trial(NamedTuple):
    weight: Tensor
    fit: LeastSquares

    def rows(self, rows: Tensor) -> "_Trial":
        return _Trial(self.weight[rows], LeastSquares(*(value[rows] for value in self.fit)))

    def put(self, rows: Tensor, part: "_Trial") -> "_Trial":
        pairs = zip(self.fit, part.fit, strict=True)
        fit = LeastSquares(*(value.index_copy(0, rows, new) for value, new in pairs))
        return _Trial(self.weight.index_copy(0, rows, part.weight), fit)


Solve = Callable[[Tensor, Tensor], LeastSquares]
"""Solves receptions: takes their rows, int64, shape (n,), and weights, shape (n, S)."""


def consistent_part(
    solve: Solve, weight: Tensor, first: LeastSquares, *, probability: float, exclusions: int
) -> Consistent:
    """Exclude outlying satellites until the rest is consistent.

    A fault is excluded only while one observation more is left to control the rest; with a
    single one to spare a fault is seen but not to be found.

    Args:
        solve: Solves a choice of receptions with given weights; the last solution it is asked
            for a reception is the one that counts.
        weight: Inverse variances, shape (N, S).
        first: Solution with these weights.
        probability: Share of sound receptions that pass the test.
        exclusions: Most satellites that may go.
    """
    limit = limits(probability, weight.shape[-1]).to(weight.device)
    now = _Trial(weight, first)
    at_first = (weight > 0.0).sum(-1)
    for _ in range(exclusions):
        spare = exclusions - (at_first - (now.weight > 0.0).sum(-1))
        doubtful = _fails(now.fit, limit) & (now.fit.degrees >= 2) & (spare >= 1)
        rows = torch.nonzero(doubtful).squeeze(-1)
        if rows.numel() == 0:
            break
        before = now.rows(rows)
        now = now.put(rows, _without(before, _worst(before.fit), rows, solve))
        again = _fails(now.fit, limit)[rows] & (before.fit.degrees >= 3) & (spare[rows] >= 2)
        part = torch.nonzero(again).squeeze(-1)
        if part.numel():
            before = before.rows(part)
            pair = _worst_pair(before)
            now = now.put(rows[part], _without(before, pair, rows[part], solve))
    return Consistent(now.weight, now.fit.solvable & ~_fails(now.fit, limit))


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


def _fails(fit: LeastSquares, limit: Tensor) -> Tensor:
    failed: Tensor = fit.solvable & ~(fit.square <= limit[fit.degrees.clamp_min(0)])
    return failed


def _without(before: _Trial, which: Tensor, rows: Tensor, solve: Solve) -> _Trial:
    """Return the trial less some observations, (n, k) of them per reception."""
    weight = before.weight.scatter(-1, which, 0.0)
    return _Trial(weight, solve(rows, weight))


def _worst(fit: LeastSquares) -> Tensor:
    return fit.normalised.abs().argmax(-1, keepdim=True)


def _worst_pair(trial: _Trial) -> Tensor:
    """Return the two observations without which the squares are least, shape (n, 2).

    With whitened residuals r and their redundancy R the squares fall by rᵀ R⁻¹ r of the two.
    """
    count = trial.weight.shape[-1]
    root = trial.weight.sqrt()
    whitened = trial.fit.design * root.unsqueeze(-1)
    eye = torch.eye(count, dtype=root.dtype, device=root.device)
    redundancy = eye - whitened @ trial.fit.cofactor @ whitened.transpose(-1, -2)
    own = redundancy.diagonal(dim1=-2, dim2=-1)
    residual = root * trial.fit.residual
    first, second = residual.unsqueeze(-1), residual.unsqueeze(-2)
    determinant = own.unsqueeze(-1) * own.unsqueeze(-2) - redundancy**2
    fall = own.unsqueeze(-2) * first**2 + own.unsqueeze(-1) * second**2
    fall = (fall - 2.0 * redundancy * first * second) / determinant.clamp_min(_SEPARABLE)
    on = trial.weight > 0.0
    told_apart = on.unsqueeze(-1) & on.unsqueeze(-2) & (determinant > _SEPARABLE)
    best = torch.where(told_apart & (eye == 0.0), fall, -1.0).flatten(-2).argmax(-1)
    return torch.stack((best // count, best % count), dim=-1)
