"""Weighted least squares of few unknowns, for many receptions at once, that never raises.

Source: [Groves2013] §9.4.1; residuals' redundancy as in [Baarda1968].
"""

from typing import NamedTuple

import torch
from torch import Tensor

_LEAST_PIVOT = 1e-6
"""Smallest pivot, of equations scaled to a unit diagonal, that still tells unknowns apart."""


class LeastSquares(NamedTuple):
    """Solution of one linear problem per reception, shape (...) each unless said otherwise.

    Attributes:
        estimate: Unknowns; 0 where nothing is observed or nothing can be told, shape (..., u).
        cofactor: Inverse of the normal equations, the covariance where weights are inverse
            variances, shape (..., u, u).
        residual: Observed minus fitted, also of what has no weight, shape (..., S).
        normalised: Residual over its own deviation, 0 where unweighted or where nothing else
            controls it; standard normal where all is well, shape (..., S).
        square: Weighted sum of squared residuals, χ² where all is well.
        degrees: Observations less unknowns, int64; below 0 where there are too few.
        solvable: Whether the unknowns that are observed can be told apart, bool.
        observed: Which unknowns are observed at all, bool, shape (..., u).
        design: Derivatives of observations to unknowns, as given, shape (..., S, u).
    """

    estimate: Tensor
    cofactor: Tensor
    residual: Tensor
    normalised: Tensor
    square: Tensor
    degrees: Tensor
    solvable: Tensor
    observed: Tensor
    design: Tensor


def weighted_least_squares(design: Tensor, observation: Tensor, weight: Tensor) -> LeastSquares:
    """Solve for unknowns by weighted observations.

    An unknown that no weighted observation touches is left at zero and counts for nothing.

    Args:
        design: Derivatives of observations to unknowns, shape (..., S, u).
        observation: Observations, finite also where the weight is zero, shape (..., S).
        weight: Inverse variances, 0 for what is left out, shape (..., S).
    """
    weighted = design * weight.unsqueeze(-1)
    normal = torch.matmul(weighted.transpose(-1, -2), design)
    diagonal = normal.diagonal(dim1=-2, dim2=-1)
    observed = diagonal > 0.0
    scale = torch.where(observed, diagonal, torch.ones_like(diagonal)).rsqrt()
    eye = torch.eye(design.shape[-1], dtype=design.dtype, device=design.device)
    scaled = normal * scale.unsqueeze(-1) * scale.unsqueeze(-2)
    scaled = torch.where(observed.unsqueeze(-1) & observed.unsqueeze(-2), scaled, eye)
    degrees = (weight > 0.0).sum(-1) - observed.sum(-1)
    solvable = (degrees >= 0) & _told_apart(scaled.detach())
    scaled = torch.where(solvable.unsqueeze(-1).unsqueeze(-1), scaled, eye)
    inverse = torch.cholesky_inverse(torch.linalg.cholesky_ex(scaled).L)
    cofactor = inverse * scale.unsqueeze(-1) * scale.unsqueeze(-2)
    right = torch.matmul(weighted.transpose(-1, -2), observation.unsqueeze(-1))
    estimate = torch.matmul(cofactor, right).squeeze(-1)
    estimate = torch.where(solvable.unsqueeze(-1), estimate, 0.0)
    residual = observation - torch.matmul(design, estimate.unsqueeze(-1)).squeeze(-1)
    leverage = weight * (torch.matmul(design, cofactor) * design).sum(-1)
    redundancy = 1.0 - leverage
    controlled = (weight > 0.0) & (redundancy > 1e-9) & solvable.unsqueeze(-1)
    ratio = weight / torch.where(controlled, redundancy, torch.ones_like(redundancy))
    return LeastSquares(
        estimate=estimate,
        cofactor=cofactor,
        residual=residual,
        normalised=torch.where(controlled, residual * torch.sqrt(ratio.detach()), 0.0),
        square=(weight * residual * residual).sum(-1),
        degrees=degrees,
        solvable=solvable & observed.any(-1),
        observed=observed,
        design=design,
    )


def _told_apart(scaled: Tensor) -> Tensor:
    factor, failed = torch.linalg.cholesky_ex(scaled)
    pivots = factor.diagonal(dim1=-2, dim2=-1)
    told: Tensor = (failed == 0) & (pivots > _LEAST_PIVOT).all(-1)
    return told


def robust_factors(fit: LeastSquares, weight: Tensor, huber: float, rounds: int = 20) -> Tensor:
    """Return what Huber's estimator multiplies weights by, by iterated reweighting.

    [Huber2009] §7.8: observations whose residual is more than so many deviations off count less
    in proportion. Not differentiable.

    Args:
        fit: Solution with the weights alone, shape (N) in its first axis.
        weight: Inverse variances, shape (N, S).
        huber: Deviations at which weights begin to fall; infinite leaves all alone.
        rounds: Most rounds.

    Returns:
        Factors in (0, 1], shape (N, S).
    """
    with torch.no_grad():
        root, factor = weight.sqrt(), torch.ones_like(weight)
        # the others are Huber's solution already
        rows = torch.nonzero(((fit.residual * root).abs() > huber).any(-1)).squeeze(-1)
        for _ in range(rounds if rows.numel() else 0):
            weighed = weight[rows] * factor[rows]
            again = weighted_least_squares(fit.design[rows], fit.residual[rows], weighed)
            new = huber / (again.residual * root[rows]).abs().clamp_min(huber)
            moving = ((new - factor[rows]).abs() > 1e-3).any(-1)
            factor[rows] = new
            rows = rows[moving]
            if rows.numel() == 0:
                break
    return factor
