"""A linear Kalman filter parallel in time, for measurements given as information.

Where many measurements meet few states, Λ = Hᵀ R⁻¹ H and η = Hᵀ R⁻¹ y say all that they say
[BarShalom2001] §7.2, and a step costs the same however many there are. With P = L Lᵀ an update is
L (I + Lᵀ Λ L)⁻¹ Lᵀ, positive whatever the rounding. The chunks are those of
:mod:`navlearn.filters.chunks`.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.chunks import Element, Filtered, filter_chunks
from navlearn.filters.ekf import propagated, symmetrized


class InformationSteps(NamedTuple):
    """A linear time-varying system with measurements: each step predicts, then updates.

    Attributes:
        transition: Φ, shape (..., K, n, n).
        shift: Added to the predicted mean, shape (..., K, n).
        noise: Q, shape (..., K, n, n).
        information: Λ = Hᵀ R⁻¹ H, shape (..., K, n, n).
        told: η = Hᵀ R⁻¹ y, shape (..., K, n).
    """

    transition: Tensor
    shift: Tensor
    noise: Tensor
    information: Tensor
    told: Tensor


def informed(
    mean: Tensor, covariance: Tensor, information: Tensor, told: Tensor
) -> tuple[Tensor, Tensor]:
    """Return mean and covariance after an update with information.

    Args:
        mean: Mean before, shape (..., n).
        covariance: P before, positive, shape (..., n, n).
        information: Λ, shape (..., n, n).
        told: η, shape (..., n).

    Returns:
        Mean, shape (..., n), and covariance, shape (..., n, n).
    """
    # _ex raises nothing here: a matrix that is not positive shows as NaN, found at the door
    root = torch.linalg.cholesky_ex(covariance)[0]
    turned = root.transpose(-1, -2)
    eye = torch.eye(mean.shape[-1], dtype=mean.dtype, device=mean.device)
    inner = torch.linalg.cholesky_ex(eye + symmetrized(turned @ information @ root))[0]
    half = torch.linalg.solve_triangular(inner, turned, upper=False)
    after = half.transpose(-1, -2) @ half
    new = told - _times(information, mean)
    return mean + _times(after, new), after


def filter_information(
    mean: Tensor, covariance: Tensor, steps: InformationSteps, chunk: int | None = None
) -> Filtered:
    """Filter all chunks of the steps side by side.

    Args:
        mean: Mean before the first step, shape (..., n).
        covariance: Covariance before the first step, positive, shape (..., n, n).
        steps: The system.
        chunk: Steps per chunk; None chooses about √K, or one chunk where the batch is so large
            that a step is work enough.

    Returns:
        Means and covariances.
    """
    return filter_chunks(mean, covariance, steps, chunk, _summed, _filtered)


def _filtered(mean: Tensor, covariance: Tensor, steps: InformationSteps) -> Filtered:
    found: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
    for F, b, Q, J, told in _in_turn(steps):
        prior, P = _times(F, mean) + b, propagated(covariance, F, Q)
        mean, covariance = informed(prior, P, J, told)
        found.append((prior, P, mean, covariance))
    means, covariances, after, spreads = zip(*found, strict=True)
    return Filtered(
        torch.stack(means, -2),
        torch.stack(covariances, -3),
        torch.stack(after, -2),
        torch.stack(spreads, -3),
    )


def _summed(steps: InformationSteps) -> Element:
    """Sum up each chunk: a filter that knows its start exactly, and what it learns of it."""
    batch, n = steps.shift.shape[:-2], steps.shift.shape[-1]
    eye = torch.eye(n, dtype=steps.shift.dtype, device=steps.shift.device)
    eta, J = steps.shift.new_zeros((*batch, n)), eye.new_zeros((*batch, n, n))
    # A, b, C side by side: what is multiplied from the same side goes in one product
    own = torch.cat((eye.expand_as(J), eta.unsqueeze(-1), J), -1)
    for F, shift, Q, information, told in _in_turn(steps):
        moved = F @ own
        A, b = moved[..., :n], moved[..., n] + shift
        C = symmetrized(moved[..., n + 1 :] @ F.transpose(-1, -2) + Q)
        right = torch.cat((A, (b + _times(C, told)).unsqueeze(-1), C), -1)
        own = torch.linalg.solve(eye + C @ information, right)
        turned = own[..., :n].transpose(-1, -2)
        J = J + turned @ information @ A
        eta = eta + _times(turned, told - _times(information, b))
        own = torch.cat((own[..., : n + 1], symmetrized(own[..., n + 1 :])), -1)
    return Element(own[..., :n], own[..., n], own[..., n + 1 :], eta, symmetrized(J))


def _in_turn(steps: InformationSteps) -> zip:  # type: ignore[type-arg]
    # unbind: indexing inside a loop would make the backward pass quadratic
    return zip(
        steps.transition.unbind(-3),
        steps.shift.unbind(-2),
        steps.noise.unbind(-3),
        steps.information.unbind(-3),
        steps.told.unbind(-2),
        strict=True,
    )


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
