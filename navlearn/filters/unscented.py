"""Sigma points of the scaled unscented transform, and what their images tell.

[Julier2002], [Ghouneem2024] Eqs. (14)–(24), whose weight of the central point is printed as a
product where a sum is meant. A spread of 1e-4 gives that point a weight of −1e8, and sums that
take it at its word keep no digit. Here points stand in pairs about the centre and all is told
relative to the centre's image: what is odd in a pair is the slope, what is even is the bend, and
no large weights are left to cancel. Angles enter as differences, so their mean is that on the
circle.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class UnscentedOptions:
    """How far sigma points lie from the mean, and how much each counts.

    λ = α² (n + κ) − n with n states; points lie γ = √(n + λ) deviations from the mean. The defaults
    lay them at √3, where the fourth moment of a normal is met, however many states there are; α = 1
    lays them at √n, four deviations for a full IMU. Up to a start's azimuth that is unsure by 30°
    every spread finds the same; from 60° on points at √n meet behind the car and tell of nothing
    (``benchmarks/unscented_spread.py``). Those at √3 meet there if it is told to be unsure by
    180°/√3, as an azimuth is that may be anything: tell 90°, or choose α so that γ is below 1.5.

    Attributes:
        alpha: Spread α; [Ghouneem2024] names 1e-4 to 1. None is √(3/(n + κ)).
        beta: Weight β of what is known of the distribution beyond its covariance; 2 for a normal.
        kappa: Secondary spread κ.
    """

    alpha: float | None = None
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a spread that leaves no points.

        Raises:
            ConfigError: If an option is outside its range.
        """
        if self.alpha is not None and not 0.0 < self.alpha <= 10.0:
            raise ConfigError(f"UnscentedOptions.alpha: found {self.alpha}; expected in (0, 10]")
        for name in ("beta", "kappa"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigError(
                    f"UnscentedOptions.{name}: found {value}; expected a finite value >= 0"
                )


class SigmaWeights(NamedTuple):
    """Weights of 2n + 1 points.

    Attributes:
        size: Number of states n.
        gamma: γ = √(n + λ), how many deviations from the mean the points lie.
        mean: W₀ᵐ of the central point in means.
        covariance: W₀ᶜ of the central point in covariances.
        each: Weight of every other point.
        shape: What the mean of the bends counts for in their covariance, see
            :func:`image_moments`.
    """

    size: int
    gamma: float
    mean: float
    covariance: float
    each: float
    shape: float


def sigma_weights(options: UnscentedOptions, size: int) -> SigmaWeights:
    """Return the weights of sigma points.

    W₀ᵐ = λ/(n+λ), W₀ᶜ = λ/(n+λ) + (1 − α² + β), the others 1/(2(n+λ)).

    Args:
        options: Spread and weights.
        size: Number of states n.

    Returns:
        Weights.
    """
    alike = size + options.kappa
    square = 3.0 / alike if options.alpha is None else options.alpha**2
    total = square * alike
    centre = 1.0 - size / total
    # root of n/γ² c² − 2c = β − α², real for every β and κ that are not negative
    inner = max(0.0, 1.0 + (size / total) * (options.beta - square))
    shape = (1.0 - math.sqrt(inner)) * total / size
    return SigmaWeights(
        size,
        math.sqrt(total),
        centre,
        centre + (1.0 - square + options.beta),
        0.5 / total,
        shape,
    )


def sigma_points(root: Tensor, weights: SigmaWeights) -> Tensor:
    """Return the points' deviations from the mean.

    Args:
        root: S with S Sᵀ = P, shape (..., n, n); its columns are used.
        weights: Weights of as many points.

    Returns:
        Deviations, the central point first, then + and − along each column, shape
        (..., 2n + 1, n).
    """
    way = weights.gamma * root.transpose(-1, -2)
    return torch.cat((torch.zeros_like(way[..., :1, :]), way, -way), -2)


class ImageMoments(NamedTuple):
    """What images of sigma points tell; q is the length of an image.

    The mean is the central image plus ``shift``, the covariance slope slopeᵀ + bend bendᵀ, and the
    covariance with the points S slopeᵀ.

    Attributes:
        shift: Mean of the images minus the central image, shape (..., q).
        slope: How the image moves per column of the root, shape (..., q, n).
        bend: A root of what a linear function would not leave, shape (..., q, n).
    """

    shift: Tensor
    slope: Tensor
    bend: Tensor

    @property
    def unexplained(self) -> Tensor:
        """Ω, the part of the covariance that no linear function of the points explains."""
        return self.bend @ self.bend.transpose(-1, -2)

    @property
    def covariance(self) -> Tensor:
        """Covariance of the images, shape (..., q, q)."""
        return self.slope @ self.slope.transpose(-1, -2) + self.unexplained


def image_moments(images: Tensor, weights: SigmaWeights) -> ImageMoments:
    """Return mean and covariance of images of sigma points.

    With a pair's odd half a = (y₊ − y₋)/2 and even half s = (y₊ + y₋)/2 − y₀ the weighted sums are
    mean y₀ + m, m = Σ s/γ², and covariance Σ a aᵀ/γ² + Σ s sᵀ/γ² + (β − α²) m mᵀ. The second and
    third term together are Σ (s − c m)(s − c m)ᵀ/γ² with n c²/γ² − 2c = β − α²: positive
    semidefinite for any spread, though W₀ᶜ may be very negative.

    Args:
        images: Images minus that of the central point, ordered as :func:`sigma_points`, shape
            (..., 2n + 1, q).
        weights: Their weights.

    Returns:
        Moments.
    """
    n, gamma = weights.size, weights.gamma
    plus, minus = images[..., 1 : n + 1, :], images[..., n + 1 :, :]
    odd, even = 0.5 * (plus - minus), 0.5 * (plus + minus)
    shift = even.sum(-2) / (gamma * gamma)
    bend = (even - weights.shape * shift.unsqueeze(-2)) / gamma
    return ImageMoments(shift, odd.transpose(-1, -2) / gamma, bend.transpose(-1, -2))
