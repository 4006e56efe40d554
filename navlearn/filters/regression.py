"""Statistical linear regression: the linear function that fits sigma points best.

[GarciaFernandez2015]: with points x and images y, Φ = P_yx P⁻¹ and Ω = P_yy − Φ P Φᵀ. A Kalman
filter with Φ, and Ω beside the noise, is the unscented filter.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.unscented import ImageMoments


class Regressed(NamedTuple):
    """A function as sigma points see it: image ≈ central image + shift + slope · deviation + rest.

    Attributes:
        slope: Φ or H, shape (..., q, n).
        shift: Mean of the images minus the central image, shape (..., q).
        bend: A root of Ω, the covariance of the rest, shape (..., q, n).
    """

    slope: Tensor
    shift: Tensor
    bend: Tensor

    @property
    def unexplained(self) -> Tensor:
        """Ω, shape (..., q, q)."""
        return self.bend @ self.bend.transpose(-1, -2)


def regressed(root: Tensor, moments: ImageMoments, derivative: Tensor) -> Regressed:
    """Return the regression of images on points.

    Args:
        root: Lower triangular root of the points' covariance, shape (..., n, n).
        moments: What the images tell.
        derivative: The function's derivative at the central point, shape (..., q, n); it answers
            for states of variance zero, of which points tell nothing.

    Returns:
        Regression.
    """
    variance = root.diagonal(dim1=-2, dim2=-1)
    idle = variance == 0.0
    beyond = moments.slope - derivative @ root
    sure = root + torch.diag_embed(idle.to(root)) if bool(idle.any()) else root
    slope = derivative + torch.linalg.solve_triangular(sure, beyond, upper=False, left=False)
    return Regressed(slope, moments.shift, moments.bend)
