"""Volterra kernels of a parallel cascade model, in physical units.

A cascade Σ p_d (Σ g_j x_j)^d has the kernels p_d g_j1 … g_jd; a parallel model has their sums
[Korenberg1991]. Limits and clamps of the safeguard are no part of them.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.pci import PciModel
from navlearn.error_models.pci_equation import shifted_powers


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
    physical = model.physical()
    power = torch.nn.functional.pad(physical.power, (1, 0))
    power = shifted_powers(power, physical.offset)
    power = torch.nn.functional.pad(power, (0, max(0, 4 - power.shape[1])))
    zeroth = physical.constant + power[:, 0].sum()
    g = physical.taps
    return VolterraKernels(
        zeroth,
        torch.einsum("k,kai->ai", power[:, 1], g),
        torch.einsum("k,kai,kbj->aibj", power[:, 2], g, g),
        torch.einsum("k,kai,kbj,kcl->aibjcl", power[:, 3], g, g, g),
    )
