"""Ridge with priors in physical units, for the whole past and for every past origin at once."""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError


class RidgeSolution(NamedTuple):
    """Coefficients and what is known of them, by origin.

    Attributes:
        coefficients: Shape (..., J).
        covariance: Of their error, if rows and prior are what they claim, shape (..., J, J).
        rows: Rows that each solution rests on, int64, shape (...).
        chi_square: Mean square of the rows' residuals, with the prior's; one where noise and
            prior are right, shape (...).
    """

    coefficients: Tensor
    covariance: Tensor
    rows: Tensor
    chi_square: Tensor


def solve_ridge(columns: Tensor, target: Tensor, prior: Tensor, counts: Tensor) -> RidgeSolution:
    """Solve for the first rows, once per origin, from sums over the rows between origins.

    Args:
        columns: Rows of unit variance, shape (N, J).
        target: Shape (N,).
        prior: Standard deviation of each coefficient before any row, shape (J,).
        counts: How many of the first rows each origin may use, int64, not decreasing,
            shape (B,).

    Raises:
        ShapeError: Shapes do not belong together, or counts decrease or exceed the rows.
    """
    n, j = columns.shape
    low, high = (int(counts.min()), int(counts.max())) if len(counts) else (0, 0)
    falls = bool((torch.diff(counts) < 0).any())
    if target.shape != (n,) or prior.shape != (j,) or low < 0 or high > n or falls:
        raise ShapeError(
            f"ridge: columns {tuple(columns.shape)}, target {tuple(target.shape)}, prior "
            f"{tuple(prior.shape)}, counts from {low} to {high}; expected (N, J), (N,), (J,) and "
            "counts that rise within 0 to N"
        )
    # In units of the prior, so that the identity is the prior's information.
    rows = torch.cat((columns * prior, target.unsqueeze(-1)), -1)
    edges = [0, *counts.tolist()]
    parts = [rows[begin:end].T @ rows[begin:end] for begin, end in pairwise(edges)]
    total = torch.cumsum(torch.stack(parts), 0) if parts else rows.new_zeros(0, j + 1, j + 1)
    information = total[:, :j, :j] + torch.eye(j, dtype=rows.dtype)
    factor = torch.linalg.cholesky(information)
    right = total[:, :j, j:]
    scaled = torch.cholesky_solve(right, factor).squeeze(-1)
    covariance = torch.cholesky_inverse(factor) * prior.unsqueeze(-1) * prior
    explained = (scaled * right.squeeze(-1)).sum(-1)
    left = (total[:, j, j] - explained) / counts.clamp(min=1)
    return RidgeSolution(scaled * prior, covariance, counts, left)
