"""Is a filter as good as it says? NEES, NIS and their χ² bands.

[BarShalom2001] §5.4: the normalised squares of an honest filter are χ² distributed with as many
degrees of freedom as they have components.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError


class Band(NamedTuple):
    """Two-sided interval.

    Attributes:
        low: Lower end.
        high: Upper end.
    """

    low: float
    high: float


def chi_square_quantile(probability: float, degrees: float) -> float:
    """Return the value that a χ² variable stays below with a probability.

    The regularised incomplete gamma function inverted by bisection.

    Args:
        probability: In (0, 1); 1 gives infinity.
        degrees: Degrees of freedom, more than 0.

    Returns:
        Quantile.

    Raises:
        ConfigError: If probability or degrees lie outside their range.
    """
    if not 0.0 < probability <= 1.0 or not degrees > 0.0:
        raise ConfigError(
            f"chi_square_quantile: found probability {probability}, degrees {degrees}; expected "
            "a probability in (0, 1] and degrees above 0"
        )
    if probability == 1.0:
        return float("inf")
    half = torch.tensor(0.5 * degrees, dtype=torch.float64)

    def below(value: float) -> float:
        return float(torch.special.gammainc(half, torch.tensor(0.5 * value, dtype=torch.float64)))

    low, high = 0.0, degrees + 10.0
    while below(high) < probability:
        high *= 2.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) < probability else (low, middle)
    return 0.5 * (low + high)


def mean_band(degrees: int, count: int, probability: float = 0.95) -> Band:
    """Return the interval in which the mean of independent normalised squares should lie.

    [BarShalom2001] Eq. (5.4.2-9).

    Args:
        degrees: Degrees of freedom of each square.
        count: Number of squares averaged.
        probability: Share of honest filters inside the interval.

    Returns:
        Interval.
    """
    tail = 0.5 * (1.0 - probability)
    total = float(degrees * count)
    return Band(
        chi_square_quantile(tail, total) / count, chi_square_quantile(1.0 - tail, total) / count
    )


def nees(error: Tensor, covariance: Tensor) -> Tensor:
    """Return the normalised estimation error squared, eᵀ P⁻¹ e.

    [BarShalom2001] Eq. (5.4.2-1).

    Args:
        error: Estimate minus truth, shape (..., n).
        covariance: P, shape (..., n, n).

    Returns:
        NEES, shape (...).
    """
    factor = torch.linalg.cholesky(covariance)
    white = torch.linalg.solve_triangular(factor, error.unsqueeze(-1), upper=False)
    square: Tensor = (white * white).sum(dim=(-2, -1))
    return square
