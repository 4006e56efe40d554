"""Measurements that are noisy together, turned into independent ones of unit variance."""

import torch
from torch import Tensor


def whitened(observation: Tensor, covariance: Tensor, innovation: Tensor) -> tuple[Tensor, Tensor]:
    """Return rows of independent noise and unit variance that tell the same.

    [BarShalom2001] §5.2.4: with R = L Lᵀ, rows L⁻¹ H and L⁻¹ ν.

    Args:
        observation: H, shape (..., r, n).
        covariance: R, positive definite, shape (..., r, r).
        innovation: Measured minus predicted, shape (..., r).

    Returns:
        H and innovation, shapes as given.
    """
    # scaled first: rows may be metres beside radians
    sigma = covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    correlation = covariance / (sigma.unsqueeze(-1) * sigma.unsqueeze(-2))
    factor = torch.linalg.cholesky_ex(correlation)[0]
    rows = torch.cat((observation, innovation.unsqueeze(-1)), -1) / sigma.unsqueeze(-1)
    white = torch.linalg.solve_triangular(factor, rows, upper=False)
    return white[..., :-1], white[..., -1]
