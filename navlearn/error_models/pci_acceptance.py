"""When a cascade is worth adding: both tests of acceptance, and the rows they may count on."""

import math
from functools import lru_cache

import torch
from torch import Tensor


def acceptance_threshold(
    rows: Tensor, freedom: Tensor, ways: int, level: float, paper: bool
) -> Tensor:
    """Return the least share of the residual's power that a candidate must explain.

    The ``paper`` test is 4 / rows. It leaves out that the response and the polynomial were fitted
    to the residual, and that the best of a batch is taken. Here the log-likelihood ratio
    −rows · ln(1 − share) is held against χ² of as many degrees of freedom as there are taps and
    powers. The candidates of a batch that read the same channels share their taps, so their
    number hardly matters: on white noise the best of 16 reaches what the best of 256 does, and
    both stay below this χ². Only the ways to read the channels are counted (Bonferroni).

    Args:
        rows: Effective number of rows of each window, shape (B,).
        freedom: Taps and powers of each candidate, shape (M,).
        ways: Number of sets of channels that candidates read.
        level: Chance of a false acceptance in the batch.
        paper: Applies the test of the paper.

    Returns:
        Shape (B, M).
    """
    if paper:
        return (4.0 / rows).unsqueeze(-1).expand(-1, freedom.shape[0])
    quantile = [chi_squared_quantile(k, level / ways) for k in freedom.tolist()]
    share = -torch.expm1(-torch.tensor(quantile, dtype=torch.float64) / rows.unsqueeze(-1))
    # As many taps and powers as rows explain anything.
    return torch.where(rows.unsqueeze(-1) > freedom + 1.0, share, torch.inf)


@lru_cache(maxsize=4096)
def chi_squared_quantile(freedom: float, tail: float) -> float:
    """Return what χ² exceeds with the chance ``tail``.

    Bisected below Laurent and Massart's bound k + 2√(kt) + 2t, t = −ln(tail).

    Args:
        freedom: Degrees of freedom k.
        tail: Chance, between 0 and 1.
    """
    t = -math.log(tail)
    half = torch.tensor(0.5 * freedom, dtype=torch.float64)
    low, high = 0.0, freedom + 2.0 * math.sqrt(freedom * t) + 2.0 * t
    for _ in range(60):
        middle = 0.5 * (low + high)
        beyond = torch.special.gammaincc(half, torch.tensor(0.5 * middle, dtype=torch.float64))
        low, high = (middle, high) if float(beyond) > tail else (low, middle)
    return high


def autocorrelations(series: Tensor, root: Tensor) -> Tensor:
    """Return the autocorrelations of weighted series at lags 1 to a quarter of their length.

    Rows are taken as neighbours in time, joints of windows too.

    Args:
        series: Channels, shape (B, N, m).
        root: Root of the weight of each row, of squared sum 1, shape (B, N).

    Returns:
        Shape (B, J, m).
    """
    count = series.shape[-2]
    share = (root * root).unsqueeze(-1)
    centred = (series - (share * series).sum(-2, keepdim=True)) * root.unsqueeze(-1)
    spectrum = torch.fft.rfft(centred, n=2 * count, dim=-2)
    lagged = torch.fft.irfft(spectrum.abs() ** 2, n=2 * count, dim=-2)[:, : max(count // 4, 1)]
    scaled: Tensor = lagged[:, 1:] / lagged[:, :1].clamp(min=1e-300)
    return scaled


def effective_rows(rows: Tensor, inputs: Tensor, residual: Tensor) -> Tensor:
    """Return the number of independent rows, after Bartlett: rows / (1 + 2 Σ ρ_x(j) ρ_y(j)).

    Two slow series agree by chance far more often than two of white noise. The channel that
    leaves the fewest rows decides.

    Args:
        rows: Number of rows of each window, shape (B,).
        inputs: Autocorrelations of the channels, shape (B, J, m).
        residual: Those of what is explained, shape (B, J, 1).
    """
    inflation = 1.0 + 2.0 * (residual * inputs).sum(-2).amax(-1)
    return (rows / inflation.clamp(min=1.0)).clamp(min=1.0)
