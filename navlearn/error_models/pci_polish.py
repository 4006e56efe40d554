"""Polishing the linear elements of parallel cascades together, beyond the paper.

A cross-correlation points near a linear element of the system, seldom at it. Here all responses
move together by Levenberg–Marquardt on the residual that is left when all polynomials are fitted
again (variable projection, Kaufman's Jacobian), for many windows at once.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.pci_candidates import Cascades, fit_cascades

RIDGE = 1e-13
"""Added to Gram matrices of unit columns: columns may be dependent, or zero for no cascade."""

ENOUGH = 1e-4
"""Share of the residual's power by which a step must lower it for another to follow."""


class _Point(NamedTuple):
    """Where the responses stand.

    Attributes:
        response: Responses of unit output power, shape (B, K, L).
        slope: Derivative of the fitted output by each linear output, shape (B, K, N).
        columns: Columns of all polynomials, shape (B, N, K D + 1).
        factor: Cholesky factor of their Gram matrix.
        residual: What is left, times ``root``, shape (B, N).
        power: Its power, shape (B,).
    """

    response: Tensor
    slope: Tensor
    columns: Tensor
    factor: Tensor
    residual: Tensor
    power: Tensor


def polish(
    lagged: Tensor, target: Tensor, root: Tensor, response: Tensor, degree: int, steps: int
) -> tuple[Tensor, Tensor]:
    """Return responses that explain more together, and the residual, times ``root``.

    Taps that are zero stay zero: a cascade reads the channels that it read before.

    Args:
        lagged: Lagged inputs of each window, shape (B, N, L).
        target: What all cascades together explain, times ``root``, shape (B, N).
        root: Root of the weight of each row, of squared sum 1, shape (B, N).
        response: Responses, shape (B, K, L); a row of zeros is no cascade.
        degree: Degree of the polynomials.
        steps: Most steps.

    Returns:
        Responses of unit output power, shape (B, K, L), and the residual, shape (B, N).
    """
    free = response != 0.0
    point = _fit(lagged, target, root, response, degree)
    damping, done = torch.full_like(point.power, 1e-2), torch.zeros_like(point.power).bool()
    for _ in range(steps):
        step = _step(point, lagged, root, free, damping)
        tried = _fit(lagged, target, root, point.response + step, degree)
        # A window that is done rests, so that its neighbours do not change what it becomes.
        better = (tried.power < point.power) & ~done
        enough = better & (tried.power > (1.0 - ENOUGH) * point.power)
        damping = torch.where(better, 0.1 * damping, 10.0 * damping).clamp(min=1e-9)
        point = _Point(
            *(
                torch.where(better.reshape(-1, *[1] * (old.ndim - 1)), new, old)
                for new, old in zip(tried, point, strict=True)
            )
        )
        done = done | enough | (damping > 1e3)
        if bool(done.all()):
            break
    return point.response, point.residual


def _fit(lagged: Tensor, target: Tensor, root: Tensor, response: Tensor, degree: int) -> _Point:
    """Fit all polynomials together."""
    cascades, _ = fit_cascades(lagged, target, root, response, degree)
    u = cascades.response @ lagged.mT
    values, slopes = _basis_and_slopes(u, cascades)
    weighted = values * root[:, None, None]
    columns = torch.cat((root.unsqueeze(1), weighted.flatten(1, 2)), 1).mT
    gram = columns.mT @ columns
    gram.diagonal(dim1=-2, dim2=-1).add_(RIDGE)
    factor: Tensor = torch.linalg.cholesky(gram)
    weight = torch.cholesky_solve(columns.mT @ target.unsqueeze(-1), factor)
    residual = target - (columns @ weight).squeeze(-1)
    each = weight[:, 1:, 0].reshape(*values.shape[:3], 1)
    slope = (each * slopes).sum(2)
    return _Point(cascades.response, slope, columns, factor, residual, residual.square().sum(-1))


def _basis_and_slopes(u: Tensor, cascades: Cascades) -> tuple[Tensor, Tensor]:
    """Return the polynomials of degree 1 to D and their derivatives, shape (B, K, D, N)."""
    shift, norm = cascades.shift.unsqueeze(-1), cascades.norm.unsqueeze(-1)
    alive = (cascades.response != 0.0).any(-1)[..., None]
    before, here = torch.zeros_like(u), torch.ones_like(u) * alive
    slope_before, slope = torch.zeros_like(u), torch.zeros_like(u)
    values, slopes = [], []
    for d in range(shift.shape[2]):
        past = norm[:, :, d - 1] if d > 0 else 0.0
        centred = u - shift[:, :, d]
        ahead = (centred * here - past * before) / norm[:, :, d]
        rising = (here + centred * slope - past * slope_before) / norm[:, :, d]
        before, here, slope_before, slope = here, ahead, slope, rising
        values.append(here)
        slopes.append(slope)
    return torch.stack(values, 2), torch.stack(slopes, 2)


def _step(point: _Point, lagged: Tensor, root: Tensor, free: Tensor, damping: Tensor) -> Tensor:
    """Return the damped Gauss–Newton step of all responses, shape (B, K, L)."""
    windows, count, taps = free.shape
    scaled = (root.unsqueeze(1) * point.slope).unsqueeze(-1)
    jacobian = (scaled * lagged.unsqueeze(1)) * free.unsqueeze(2)
    jacobian = jacobian.transpose(1, 2).reshape(windows, -1, count * taps)
    inside = point.columns.mT @ jacobian
    inside = torch.linalg.solve_triangular(point.factor, inside, upper=False)
    hessian = jacobian.mT @ jacobian - inside.mT @ inside
    gradient = jacobian.mT @ point.residual.unsqueeze(-1)
    diagonal = hessian.diagonal(dim1=-2, dim2=-1)
    floor = 1e-12 * diagonal.amax(-1, keepdim=True) + 1e-30
    # Every scale of a response fits alike; only the damping holds it.
    diagonal.add_(damping.unsqueeze(-1) * diagonal.clamp(min=0.0) + floor)
    step, _ = torch.linalg.solve_ex(hessian, gradient)
    return torch.nan_to_num(step, 0.0, 0.0, 0.0).reshape(windows, count, taps)
