"""Volterra kernels of a parallel cascade model, in physical units.

A cascade Σ p_d (Σ g_j x_j)^d has the kernels p_d g_j1 … g_jd; a parallel model has their sums
[Korenberg1991]. Limits and clamps of the safeguard are no part of them.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.pci import PciModel


class VolterraKernels(NamedTuple):
    """Symmetric kernels of y(n) = h0 + Σ h1 x + ΣΣ h2 x x + ΣΣΣ h3 x x x.

    Axes go in pairs of lag (0 to R) and channel, so that a pair indexes x_i(n − j).

    Attributes:
        zeroth: Shape ().
        first: Shape (R + 1, m).
        second: Shape (R + 1, m, R + 1, m).
        third: Shape (R + 1, m, R + 1, m, R + 1, m).
    """

    zeroth: Tensor
    first: Tensor
    second: Tensor
    third: Tensor


def volterra_kernels(model: PciModel) -> VolterraKernels:
    """Return the kernels up to third order of a fitted model.

    For polynomials of degree up to 3 they are the whole model; of higher degrees they are its
    part up to third order about x = 0.

    Args:
        model: Fitted model.
    """
    response = model.response / model.u_scale
    offset = -(response * model.u_mean).sum((-1, -2))
    power = model.y_scale * _shifted(_powers(model), offset)
    power = torch.nn.functional.pad(power, (0, max(0, 4 - power.shape[1])))
    zeroth = model.y_mean.squeeze(0) + power[:, 0].sum()
    g = response
    return VolterraKernels(
        zeroth,
        torch.einsum("k,kai->ai", power[:, 1], g),
        torch.einsum("k,kai,kbj->aibj", power[:, 2], g, g),
        torch.einsum("k,kai,kbj,kcl->aibjcl", power[:, 3], g, g, g),
    )


def _powers(model: PciModel) -> Tensor:
    """Return the polynomials' coefficients of powers of the linear output, shape (K, D + 1)."""
    count, degree = model.shift.shape
    before = torch.zeros(count, degree + 1, dtype=torch.float64)
    here = before.clone()
    here[:, 0] = 1.0
    total = model.weight[:, :1] * here
    for d in range(degree):
        ahead = here.roll(1, -1) - model.shift[:, d : d + 1] * here
        if d > 0:
            ahead = ahead - model.norm[:, d - 1 : d] * before
        before, here = here, ahead / model.norm[:, d : d + 1]
        total = total + model.weight[:, d + 1 : d + 2] * here
    return total


def _shifted(power: Tensor, offset: Tensor) -> Tensor:
    """Return the coefficients in v of polynomials in u = v + offset, shape (K, D + 1)."""
    size = power.shape[1]
    shifted = torch.zeros_like(power)
    for d in range(size):
        for q in range(d + 1):
            shifted[:, q] += math.comb(d, q) * power[:, d] * offset ** (d - q)
    return shifted
