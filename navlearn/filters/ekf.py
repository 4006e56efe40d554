"""The linear algebra of a Kalman update, for any model.

[BarShalom2001] §5.2: Joseph form, so that the covariance stays positive whatever the gain's
rounding. A measurement that is not there has a zero row in H, a zero innovation and any positive
variance: it then changes nothing, to the last bit of the mathematics.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class Corrected(NamedTuple):
    """What an update gives.

    Attributes:
        correction: To be added to the estimate, shape (..., n).
        covariance: Covariance after the update, shape (..., n, n).
        gain: Kalman gain, shape (..., n, r).
    """

    correction: Tensor
    covariance: Tensor
    gain: Tensor


def symmetrized(matrix: Tensor) -> Tensor:
    """Return the symmetric part of matrices.

    Args:
        matrix: Shape (..., n, n).

    Returns:
        Shape (..., n, n).
    """
    return 0.5 * (matrix + matrix.transpose(-1, -2))


def propagated(covariance: Tensor, transition: Tensor, noise: Tensor) -> Tensor:
    """Return the covariance after one prediction, Φ P Φᵀ + Q.

    Args:
        covariance: P before, shape (..., n, n).
        transition: Φ, shape (..., n, n).
        noise: Q, shape (..., n, n).

    Returns:
        P after, symmetric, shape (..., n, n).
    """
    return symmetrized(transition @ covariance @ transition.transpose(-1, -2) + noise)


def projected(covariance: Tensor, observation: Tensor) -> tuple[Tensor, Tensor]:
    """Return what a covariance means for the predicted measurement.

    Args:
        covariance: P, shape (..., n, n).
        observation: H, shape (..., r, n).

    Returns:
        H P, shape (..., r, n), and H P Hᵀ, symmetric, shape (..., r, r).
    """
    cross = observation @ covariance
    return cross, symmetrized(cross @ observation.transpose(-1, -2))


def gain_of_projected(cross: Tensor, spread: Tensor, variance: Tensor) -> Tensor:
    """Return the gain K = P Hᵀ (H P Hᵀ + R)⁻¹ of what :func:`projected` returns.

    Args:
        cross: H P, shape (..., r, n).
        spread: H P Hᵀ, shape (..., r, r).
        variance: Diagonal of R, shape (..., r).

    Returns:
        Gain, shape (..., n, r).
    """
    # _ex raises nothing here: a matrix that is not positive shows as NaN, found at the door
    factor = torch.linalg.cholesky_ex(spread + torch.diag_embed(variance))[0]
    return torch.cholesky_solve(cross, factor).transpose(-1, -2)


def kalman_gain(covariance: Tensor, observation: Tensor, variance: Tensor) -> Tensor:
    """Return the gain K = P Hᵀ (H P Hᵀ + R)⁻¹.

    Args:
        covariance: P before the update, shape (..., n, n).
        observation: H, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).

    Returns:
        Gain, shape (..., n, r).
    """
    cross, spread = projected(covariance, observation)
    return gain_of_projected(cross, spread, variance)


def joseph(covariance: Tensor, observation: Tensor, variance: Tensor, gain: Tensor) -> Tensor:
    """Return the covariance after an update with any gain.

    [BarShalom2001] Eq. (5.2.3-18): (I − K H) P (I − K H)ᵀ + K R Kᵀ.

    Args:
        covariance: P before the update, shape (..., n, n).
        observation: H, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).
        gain: K, shape (..., n, r).

    Returns:
        P after, symmetric, shape (..., n, n).
    """
    eye = torch.eye(covariance.shape[-1], dtype=covariance.dtype, device=covariance.device)
    left = eye - gain @ observation
    scaled = gain * variance.unsqueeze(-2)
    return symmetrized(left @ covariance @ left.transpose(-1, -2) + scaled @ gain.transpose(-1, -2))


def joseph_of_reduced(
    reduced: Tensor, observation: Tensor, variance: Tensor, gain: Tensor
) -> Tensor:
    """Return the same as :func:`joseph` from (I − K H) P, in products of r columns.

    Needed where a huge P meets a tiny R: what rounding leaves of (I − K H) P is no covariance.

    Args:
        reduced: (I − K H) P, shape (..., n, n).
        observation: H, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).
        gain: K, shape (..., n, r).

    Returns:
        P after, symmetric, shape (..., n, n).
    """
    left = reduced @ observation.transpose(-1, -2) - gain * variance.unsqueeze(-2)
    return symmetrized(reduced - left @ gain.transpose(-1, -2))


def update(
    covariance: Tensor, observation: Tensor, variance: Tensor, innovation: Tensor
) -> Corrected:
    """Return correction and covariance of one update with independent measurements.

    Args:
        covariance: P before the update, shape (..., n, n).
        observation: H, derivative of the predicted measurement, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).
        innovation: Measured minus predicted, shape (..., r).

    Returns:
        Correction, covariance and gain.
    """
    gain = kalman_gain(covariance, observation, variance)
    return corrected(covariance, observation, variance, innovation, gain)


def corrected(
    covariance: Tensor, observation: Tensor, variance: Tensor, innovation: Tensor, gain: Tensor
) -> Corrected:
    """Return correction and covariance of one update with any gain.

    Args:
        covariance: P before the update, shape (..., n, n).
        observation: H, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).
        innovation: Measured minus predicted, shape (..., r).
        gain: K, shape (..., n, r).

    Returns:
        Correction, covariance and gain.
    """
    correction = (gain @ innovation.unsqueeze(-1)).squeeze(-1)
    return Corrected(correction, joseph(covariance, observation, variance, gain), gain)


def update_in_turn(
    covariance: Tensor, observation: Tensor, variance: Tensor, innovation: Tensor
) -> Corrected:
    """Return the same update as :func:`update`, one scalar measurement after another.

    [BarShalom2001] §5.2.4 for a diagonal R; needs no factorisation, so it scripts and ports
    to small computers. The gain returned is that of the whole update.

    Args:
        covariance: P before the update, shape (..., n, n).
        observation: H, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).
        innovation: Measured minus predicted, shape (..., r).

    Returns:
        Correction, covariance and gain.
    """
    n, r = covariance.shape[-1], variance.shape[-1]
    eye = torch.eye(n, dtype=covariance.dtype, device=covariance.device)
    unit = torch.eye(r, dtype=covariance.dtype, device=covariance.device)
    gain = torch.zeros_like(observation.transpose(-1, -2))
    for i in range(r):
        row = observation[..., i : i + 1, :]
        column = covariance @ row.transpose(-1, -2)
        spread = row @ column + variance[..., i : i + 1].unsqueeze(-1)
        k = column / spread
        left = eye - k @ row
        gain = left @ gain + k * unit[i]
        noise = k * variance[..., i : i + 1].unsqueeze(-1)
        covariance = symmetrized(
            left @ covariance @ left.transpose(-1, -2) + noise @ k.transpose(-1, -2)
        )
    correction = (gain @ innovation.unsqueeze(-1)).squeeze(-1)
    return Corrected(correction, covariance, gain)


def normalized_square(
    covariance: Tensor, observation: Tensor, variance: Tensor, innovation: Tensor
) -> Tensor:
    """Return νᵀ (H P Hᵀ + R)⁻¹ ν, the normalised innovation squared (NIS).

    [BarShalom2001] Eq. (5.4.2-2).

    Args:
        covariance: P before the update, shape (..., n, n).
        observation: H, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).
        innovation: Measured minus predicted, shape (..., r).

    Returns:
        NIS, shape (...).
    """
    spread = symmetrized(observation @ covariance @ observation.transpose(-1, -2))
    factor = torch.linalg.cholesky_ex(spread + torch.diag_embed(variance))[0]
    white = torch.linalg.solve_triangular(factor, innovation.unsqueeze(-1), upper=False)
    square: Tensor = (white * white).sum(dim=(-2, -1))
    return square
