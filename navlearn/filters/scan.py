"""A linear Kalman filter parallel in time, for measurements in rows.

:func:`filter_in_turn` is the textbook; the chunks are those of :mod:`navlearn.filters.chunks`.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.chunks import Element, Filtered, filter_chunks
from navlearn.filters.ekf import (
    gain_of_projected,
    joseph,
    joseph_of_reduced,
    kalman_gain,
    propagated,
    symmetrized,
)


class LinearSteps(NamedTuple):
    """A linear time-varying system with measurements: each step predicts, then updates.

    Attributes:
        transition: Φ, shape (..., K, n, n).
        shift: Added to the predicted mean, shape (..., K, n).
        noise: Q, shape (..., K, n, n).
        observation: H, shape (..., K, r, n).
        variance: Diagonal of R, shape (..., K, r).
        measurement: y, shape (..., K, r).
    """

    transition: Tensor
    shift: Tensor
    noise: Tensor
    observation: Tensor
    variance: Tensor
    measurement: Tensor


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def filter_in_turn(mean: Tensor, covariance: Tensor, steps: LinearSteps) -> Filtered:
    """Filter one step after another: the textbook recursion, and each chunk's.

    [BarShalom2001] §5.2.

    Args:
        mean: Mean before the first step, shape (..., n).
        covariance: Covariance before the first step, shape (..., n, n).
        steps: The system.

    Returns:
        Means and covariances.
    """
    found: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
    for F, b, Q, H, R, y in _in_turn(steps):
        prior, P = _times(F, mean) + b, propagated(covariance, F, Q)
        gain = kalman_gain(P, H, R)
        mean = prior + _times(gain, y - _times(H, prior))
        covariance = joseph(P, H, R, gain)
        found.append((prior, P, mean, covariance))
    a, b, c, d = zip(*found, strict=True)
    return Filtered(torch.stack(a, -2), torch.stack(b, -3), torch.stack(c, -2), torch.stack(d, -3))


def filter_in_parallel(
    mean: Tensor, covariance: Tensor, steps: LinearSteps, chunk: int | None = None
) -> Filtered:
    """Filter all chunks of the steps side by side; equals :func:`filter_in_turn`.

    Args:
        mean: Mean before the first step, shape (..., n).
        covariance: Covariance before the first step, shape (..., n, n).
        steps: The system.
        chunk: Steps per chunk; None chooses about √K, or one chunk where the batch is so large
            that a step is work enough.

    Returns:
        Means and covariances.
    """
    return filter_chunks(mean, covariance, steps, chunk, _summed, _filtered)


def _filtered(mean: Tensor, covariance: Tensor, steps: LinearSteps) -> Filtered:
    """Filter all chunks side by side: the same recursion in fewer products."""
    n = mean.shape[-1]
    own = torch.cat((covariance, mean.unsqueeze(-1)), -1)
    priors: list[Tensor] = []
    posts: list[Tensor] = []
    for F, b, Q, H, R, y in _in_turn(steps):
        moved = F @ own
        P = symmetrized(moved[..., :n] @ F.transpose(-1, -2) + Q)
        own = torch.cat((P, moved[..., n:] + b.unsqueeze(-1)), -1)
        priors.append(own)
        seen = H @ own
        cross = seen[..., :n]
        gain = gain_of_projected(cross, symmetrized(cross @ H.transpose(-1, -2)), R)
        own = own - gain @ torch.cat((cross, seen[..., n:] - y.unsqueeze(-1)), -1)
        own = torch.cat((joseph_of_reduced(own[..., :n], H, R, gain), own[..., n:]), -1)
        posts.append(own)
    prior, post = torch.stack(priors, -3), torch.stack(posts, -3)
    return Filtered(prior[..., n], prior[..., :n], post[..., n], post[..., :n])


def _in_turn(steps: LinearSteps) -> zip:  # type: ignore[type-arg]
    # unbind: indexing inside a loop would make the backward pass quadratic
    return zip(
        steps.transition.unbind(-3),
        steps.shift.unbind(-2),
        steps.noise.unbind(-3),
        steps.observation.unbind(-3),
        steps.variance.unbind(-2),
        steps.measurement.unbind(-2),
        strict=True,
    )


def _summed(steps: LinearSteps) -> Element:
    """Sum up each chunk: a filter that knows its start exactly, and what it learns of it."""
    batch, n = steps.shift.shape[:-2], steps.shift.shape[-1]
    A = torch.eye(n, dtype=steps.shift.dtype, device=steps.shift.device).expand(*batch, n, n)
    C, b = torch.zeros_like(A), steps.shift.new_zeros((*batch, n))
    eta, J = b, C
    own = torch.cat((A, b.unsqueeze(-1), C), -1)
    for F, shift, Q, H, R, y in _in_turn(steps):
        # what is multiplied from the same side goes in one product
        moved = F @ own
        A, b = moved[..., :n], moved[..., n] + shift
        C = symmetrized(moved[..., n + 1 :] @ F.transpose(-1, -2) + Q)
        own = torch.cat((A, b.unsqueeze(-1), C), -1)
        seen = H @ own
        spread = symmetrized(seen[..., n + 1 :] @ H.transpose(-1, -2)) + torch.diag_embed(R)
        factor = torch.linalg.cholesky_ex(spread)[0]
        seen = torch.cat(
            (seen[..., :n], seen[..., n : n + 1] - y.unsqueeze(-1), seen[..., n + 1 :]), -1
        )
        solved = torch.cholesky_solve(seen, factor)
        told = seen[..., :n].transpose(-1, -2) @ solved[..., : n + 1]
        J, eta = J + told[..., :n], eta - told[..., n]
        gain = solved[..., n + 1 :].transpose(-1, -2)
        own = own - gain @ seen
        C = joseph_of_reduced(own[..., n + 1 :], H, R, gain)
        own = torch.cat((own[..., : n + 1], C), -1)
    return Element(own[..., :n], own[..., n], own[..., n + 1 :], eta, symmetrized(J))
