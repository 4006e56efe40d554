"""A Kalman filter on the root of its covariance, so that no rounding can make a variance negative.

[Kailath2000] ch. 12: roots are put side by side and turned into a triangle by a QR decomposition.
Roots are lower triangular with a diagonal that is not negative; a state of variance zero has a row
of zeros, through which gradients pass as zeros.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class RootCorrected(NamedTuple):
    """What an update gives.

    Attributes:
        correction: To be added to the estimate, shape (..., n).
        root: Root of the covariance after the update, shape (..., n, n).
        gain: Kalman gain, shape (..., n, r).
    """

    correction: Tensor
    root: Tensor
    gain: Tensor


def triangular(root: Tensor) -> Tensor:
    """Return the triangular root of M Mᵀ.

    Args:
        root: M, shape (..., n, m).

    Returns:
        Lower triangular L with L Lᵀ = M Mᵀ, shape (..., n, n).
    """
    n = root.shape[-2]
    if n == 0:
        return root.new_zeros((*root.shape[:-1], 0))
    # a row of zeros would leave a zero on the diagonal, which no gradient survives
    empty = (root == 0.0).all(-1)
    idle = bool(empty.any())
    if idle:
        root = torch.cat((root, torch.diag_embed(empty.to(root))), -1)
    if root.shape[-1] < n:
        root = torch.nn.functional.pad(root, (0, n - root.shape[-1]))
    tall = root.transpose(-1, -2)
    needed = root.requires_grad and torch.is_grad_enabled()
    upper = torch.linalg.qr(tall, mode="reduced" if needed else "r")[1]
    sign = torch.where(upper.diagonal(dim1=-2, dim2=-1) < 0.0, -1.0, 1.0).to(upper)
    lower = upper.transpose(-1, -2) * sign.unsqueeze(-2)
    return torch.where(empty.unsqueeze(-1), 0.0, lower) if idle else lower


def root_of_sum(*roots: Tensor) -> Tensor:
    """Return the root of a sum of covariances.

    Args:
        roots: Roots of the summands, shape (..., n, m) with any m each.

    Returns:
        Triangular root, shape (..., n, n).
    """
    return triangular(torch.cat(roots, -1))


def predicted_root(root: Tensor, transition: Tensor, noise: Tensor) -> Tensor:
    """Return the root of Φ P Φᵀ + Q.

    Args:
        root: Root of P, shape (..., n, n).
        transition: Φ, shape (..., n, n).
        noise: Root of Q, shape (..., n, m).

    Returns:
        Triangular root, shape (..., n, n).
    """
    return root_of_sum(transition @ root, noise)


def updated_root(
    root: Tensor, observation: Tensor, noise: Tensor, innovation: Tensor
) -> RootCorrected:
    """Return correction and root of one update.

    Args:
        root: Root of P before the update, shape (..., n, n).
        observation: H, shape (..., r, n).
        noise: Root of R, shape (..., r, m); R must have full rank.
        innovation: Measured minus predicted, shape (..., r).

    Returns:
        Correction, root and gain.
    """
    r = observation.shape[-2]
    if r == 0:
        return RootCorrected(torch.zeros_like(root[..., 0]), root, root[..., :0])
    below = root.new_zeros((*root.shape[:-1], noise.shape[-1]))
    rows = torch.cat((noise, observation @ root), -1)
    whole = triangular(torch.cat((rows, torch.cat((below, root), -1)), -2))
    spread, scaled, after = whole[..., :r, :r], whole[..., r:, :r], whole[..., r:, r:]
    # K = scaled spread⁻¹
    gain = torch.linalg.solve_triangular(spread, scaled, upper=False, left=False)
    correction = (gain @ innovation.unsqueeze(-1)).squeeze(-1)
    return RootCorrected(correction, after, gain)


def root_of(covariance: Tensor) -> Tensor:
    """Return the triangular root of a covariance that may be singular.

    Args:
        covariance: Symmetric, positive semidefinite, shape (..., n, n).

    Returns:
        Lower triangular L with L Lᵀ = P to rounding, shape (..., n, n).
    """
    variance = covariance.diagonal(dim1=-2, dim2=-1)
    flat = variance <= 0.0
    fixed = covariance + torch.diag_embed(flat.to(covariance))
    factor, failed = torch.linalg.cholesky_ex(fixed)
    if bool(failed.any()):
        return _root_in_turn(covariance)
    return torch.where(flat.unsqueeze(-1), 0.0, factor) if bool(flat.any()) else factor


def _root_in_turn(covariance: Tensor) -> Tensor:
    """Return the same column by column, leaving out directions that rounding alone would fill."""
    least = 1e-14 * covariance.shape[-1] * covariance.diagonal(dim1=-2, dim2=-1)
    below = torch.ones_like(covariance[..., 0])
    columns: list[Tensor] = []
    for j in range(covariance.shape[-1]):
        left = covariance[..., j, j]
        there = left > least[..., j]
        scale = torch.where(there, left, 1.0).rsqrt() * there
        column = covariance[..., :, j] * below * scale.unsqueeze(-1)
        columns.append(column)
        covariance = covariance - column.unsqueeze(-1) * column.unsqueeze(-2)
        below = torch.cat((torch.zeros_like(below[..., : j + 1]), below[..., j + 1 :]), -1)
    return torch.stack(columns, -1)
