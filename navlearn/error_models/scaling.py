"""Standardisation of regressors and targets, and the range they were seen in.

Every error model learns on channels of zero mean and unit spread; what leaves it is in physical
units again. The range is kept for the safeguard.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import FitError, ShapeError


class Scaling(NamedTuple):
    """What standardises one group of channels, shape (n,) each.

    Attributes:
        mean: Weighted mean of every channel.
        scale: Weighted standard deviation; 1 for a channel that never moves.
        low: Smallest value seen.
        high: Largest value seen.
    """

    mean: Tensor
    scale: Tensor
    low: Tensor
    high: Tensor


def unit_scaling(channels: int) -> Scaling:
    """Return the scaling that changes nothing and knows no range.

    Args:
        channels: Number of channels n.
    """
    zero = torch.zeros(channels, dtype=torch.float64)
    infinite = torch.full((channels,), torch.inf, dtype=torch.float64)
    return Scaling(zero, torch.ones_like(zero), -infinite, infinite)


def fit_scaling(values: Tensor, weight: Tensor) -> Scaling:
    """Return mean, spread and range of every channel over the rows that count.

    Args:
        values: Channels in physical units, shape (..., n).
        weight: Weight of each row, not negative, shape (...); rows of weight zero are not read.

    Raises:
        ShapeError: The shapes do not belong together.
        FitError: No row has a positive weight, or a row that counts is not finite.
    """
    if values.ndim < 1 or values.shape[:-1] != weight.shape:
        raise ShapeError(
            f"values have shape {tuple(values.shape)} and weight {tuple(weight.shape)}; "
            "weight must have the shape of values without its last axis"
        )
    counts = weight.reshape(-1) > 0
    rows = values.reshape(-1, values.shape[-1])[counts].double()
    share = weight.reshape(-1)[counts].double()
    if rows.shape[0] == 0:
        raise FitError("no row has a positive weight, so nothing can be learned from this record")
    if not bool(torch.isfinite(rows).all()):
        raise FitError("a row of positive weight is not finite; give it weight zero or drop it")
    share = (share / share.sum()).unsqueeze(-1)
    mean = (share * rows).sum(0)
    spread = (share * (rows - mean) ** 2).sum(0).sqrt()
    moves = spread > 1e-12 * rows.abs().amax(0).clamp(min=1e-300)
    scale = torch.where(moves, spread, torch.ones_like(spread))
    return Scaling(mean, scale, rows.amin(0), rows.amax(0))
