"""What a sceptic predicts of a range error: its last value, or a Gauss–Markov process's decay.

A Gauss–Markov process in white noise is the textbook's picture of a range error, and its Kalman
predictor is what a filter with a state per satellite would do, at the price of two numbers
estimated from the drive's own past.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor


class GaussMarkov(NamedTuple):
    """A stationary first-order process of zero mean in white noise.

    Attributes:
        variance: Of the process, m².
        correlation: Of the process from one row to the next.
        noise: Variance of the white noise on each row, m².
    """

    variance: float
    correlation: float
    noise: float


def fit_gauss_markov(target: Tensor) -> GaussMarkov:
    """Return the process whose autocovariance fits several series best.

    The autocovariances at lags from 1 on are σ²ρʲ, which the correlation time of a grid fits best
    by weighted least squares; what is left at lag 0 is white.

    Args:
        target: Series, NaN where there is none, shape (n, W).
    """
    there = torch.isfinite(target)
    y = torch.where(there, target, 0.0)
    lags = max(2, min(target.shape[-1] // 3, 120))
    found, pairs = [], []
    for lag in range(lags):
        stop = target.shape[-1] - lag
        both = there[:, lag:] & there[:, :stop]
        pairs.append(float(both.sum()))
        found.append(float((y[:, lag:] * y[:, :stop]).sum()) / max(pairs[-1], 1.0))
    covariance, weight = torch.tensor(found).double(), torch.tensor(pairs).double()
    if not found[0] > 0.0:
        return GaussMarkov(0.0, 0.0, 1.0)
    times = torch.logspace(0.0, 3.5, 36, dtype=torch.float64)
    shape = torch.exp(-torch.arange(1, lags).double() / times.unsqueeze(-1))
    w, c = weight[1:], covariance[1:]
    energy = (w * shape * shape).sum(-1).clamp(min=1e-300)
    variance = ((w * shape * c).sum(-1) / energy).clamp(min=0.0, max=found[0])
    misfit = (w * (c - variance.unsqueeze(-1) * shape).square()).sum(-1)
    best = int(misfit.argmin())
    level = float(variance[best])
    return GaussMarkov(level, float(shape[best, 0]), max(found[0] - level, 1e-3 * found[0]))


def predict_gauss_markov(
    process: GaussMarkov, target: Tensor, horizon: int
) -> tuple[Tensor, Tensor]:
    """Return what the process will be after series that end, and the variance of that.

    Args:
        process: The process.
        target: Series, NaN where there is none, shape (n, W).
        horizon: Number of rows H.

    Returns:
        Predictions and their variances, shape (n, H) each.
    """
    level = torch.zeros_like(target[:, 0])
    spread = torch.full_like(level, process.variance)
    driving = process.variance * (1.0 - process.correlation**2)
    for y in target.unbind(-1):
        level = process.correlation * level
        spread = process.correlation**2 * spread + driving
        there = torch.isfinite(y)
        gain = torch.where(there, spread / (spread + process.noise), 0.0)
        level = level + gain * torch.where(there, y - level, 0.0)
        spread = (1.0 - gain) * spread
    fade = process.correlation ** torch.arange(1, horizon + 1).to(target)
    ahead = process.variance + (spread.unsqueeze(-1) - process.variance) * fade.square()
    return level.unsqueeze(-1) * fade, ahead


def last_values(target: Tensor) -> Tensor:
    """Return the last value of each series; NaN for one without any.

    Args:
        target: Series, NaN where there is none, shape (n, W).

    Returns:
        Shape (n,).
    """
    there = torch.isfinite(target)
    place = torch.where(there, torch.arange(target.shape[-1]), -1).amax(-1)
    found = target.gather(-1, place.clamp(min=0).unsqueeze(-1)).squeeze(-1)
    return torch.where(place >= 0, found, torch.nan)


def recent_mean(target: Tensor, average: float) -> Tensor:
    """Return the exponentially weighted mean of each series up to every row.

    Args:
        target: Series, NaN where there is none, shape (n, W).
        average: Time constant of the weights, rows.

    Returns:
        NaN before a series' first value, shape (n, W).
    """
    keep = math.exp(-1.0 / average)
    total, weight = torch.zeros_like(target[:, 0]), torch.zeros_like(target[:, 0])
    means = []
    for y in target.unbind(-1):
        there = torch.isfinite(y)
        total = keep * total + torch.where(there, y, 0.0)
        weight = keep * weight + there.to(target)
        means.append(torch.where(weight > 0.0, total / weight.clamp(min=1e-300), torch.nan))
    return torch.stack(means, -1)
