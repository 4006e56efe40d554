"""Sigma points of the scaled unscented transform."""

import math
from dataclasses import dataclass

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class UnscentedOptions:
    """How far sigma points lie from the mean, and how much each counts.

    λ = α² (n + κ) − n with n states; points lie √(n + λ) deviations from the mean. The defaults
    lay them at √n deviations and give no negative weight.

    Attributes:
        alpha: Spread α; [Ghouneem2024] names 1e-4 to 1.
        beta: Weight β of what is known of the distribution beyond its covariance; 2 for a normal.
        kappa: Secondary spread κ.
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a spread that leaves no points.

        Raises:
            ConfigError: If an option is outside its range.
        """
        if not 0.0 < self.alpha <= 10.0:
            raise ConfigError(f"UnscentedOptions.alpha: found {self.alpha}; expected in (0, 10]")
        for name in ("beta", "kappa"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigError(
                    f"UnscentedOptions.{name}: found {value}; expected a finite value >= 0"
                )
