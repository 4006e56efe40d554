"""Bounds on what a learned correction may do, and the gate that lets it act.

A polynomial or network is trusted only inside the range that it has seen: inputs are clamped to
it, corrections are limited to a multiple of their own training spread, and both are counted. The
rolling-origin gate compares recent emulated outages with and without the model.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from navlearn.errors import ShapeError


def clamp_and_standardise(
    values: Tensor, low: Tensor, high: Tensor, mean: Tensor, scale: Tensor
) -> Tensor:
    """Return standardised channels, held inside their training range; NaN becomes the mean.

    Args:
        values: Channels in physical units, shape (..., n).
        low: Smallest value seen in training, shape (n,).
        high: Largest value seen in training, shape (n,).
        mean: Training mean, shape (n,).
        scale: Training spread, shape (n,).
    """
    return torch.nan_to_num((torch.clamp(values, low, high) - mean) / scale, nan=0.0)


def count_outside(values: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Count the channels that leave their training range (or are NaN), shape (...).

    Args:
        values: Channels, shape (..., n).
        low: Smallest value seen in training, shape (n,).
        high: Largest value seen in training, shape (n,).
    """
    return torch.logical_not((values >= low) & (values <= high)).sum(-1)


@dataclass(frozen=True, kw_only=True)
class GateVerdict:
    """What the rolling-origin gate decided, and on what grounds.

    Attributes:
        use: True where the model may act.
        improvement: 1 − (mean error with) / (mean error without); NaN without any replay.
        replays: Number of emulated outages compared.
        margin: Improvement that was asked for.
    """

    use: bool
    improvement: float
    replays: int
    margin: float


def rolling_origin_gate(
    error_with: Tensor, error_without: Tensor, *, margin: float = 0.05, fewest: int = 5
) -> GateVerdict:
    """Decide whether a model may act, from replays of recent emulated outages.

    The ratio of means is compared, not the mean of ratios: short easy outages must not outvote
    long hard ones.

    Args:
        error_with: Error of each replay with the model, m, shape (M,).
        error_without: Error of the same replays without it, m, shape (M,).
        margin: Least improvement asked for, as a share of the error without.
        fewest: Below this number of replays the model stays out.

    Raises:
        ShapeError: The two do not pair up.
    """
    if error_with.shape != error_without.shape or error_with.ndim != 1:
        raise ShapeError(
            f"errors with {tuple(error_with.shape)} and without {tuple(error_without.shape)} "
            "the model must be two vectors of one length, a value per replay"
        )
    replays = error_with.shape[0]
    total = float(error_without.sum()) if replays else 0.0
    improvement = 1.0 - float(error_with.sum()) / total if total > 0.0 else float("nan")
    use = replays >= fewest and improvement >= margin
    return GateVerdict(use=use, improvement=improvement, replays=replays, margin=margin)
