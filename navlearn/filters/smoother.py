"""The Rauch–Tung–Striebel smoother, one step after another and parallel in time.

[Rauch1965]; [Sarkka2013] §8.2; parallel form after [Sarkka2021] §IV-B. Seen from behind, a filter
leaves x_k = G_k x_{k+1} + g_k + N(0, L_k), which composes like any linear recursion. All gains are
found at once; stretches of about √K steps are composed side by side, the few stretches one after
another. L is kept in the form (I − G Φ) P (I − G Φ)ᵀ + G Q Gᵀ, a sum of squares: no difference of
covariances is taken anywhere.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.chunks import Filtered
from navlearn.filters.ekf import propagated, symmetrized
from navlearn.filters.scan import LinearSteps

RIDGE = 1e-12
"""Added to the predicted correlation matrix, which is singular where a state has no noise."""


class Forward(NamedTuple):
    """What a filter leaves for a smoother; K counts beliefs, K − 1 steps lie between them.

    Attributes:
        mean: After the update, shape (..., K, n).
        covariance: After the update, shape (..., K, n, n).
        ahead: Mean that the next step predicts from there, shape (..., K − 1, n).
        transition: Φ of the next step, shape (..., K − 1, n, n).
        noise: Q of the next step, shape (..., K − 1, n, n).
    """

    mean: Tensor
    covariance: Tensor
    ahead: Tensor
    transition: Tensor
    noise: Tensor


class Smoothed(NamedTuple):
    """Means and covariances given all measurements, those that came later too.

    Attributes:
        mean: Shape (..., K, n).
        covariance: Shape (..., K, n, n).
        gain: G of each step; Cov(x_k, x_{k+1}) is G_k times the covariance at k + 1,
            shape (..., K − 1, n, n).
    """

    mean: Tensor
    covariance: Tensor
    gain: Tensor


def forward_pass(
    mean: Tensor, covariance: Tensor, steps: LinearSteps, filtered: Filtered
) -> Forward:
    """Return what a linear filter leaves, the belief before its first step included.

    Args:
        mean: Mean before the first step, shape (..., n).
        covariance: Covariance before the first step, shape (..., n, n).
        steps: The system, K steps.
        filtered: What the filter made of it.

    Returns:
        Beliefs before, between and after the steps: K + 1 of them.
    """
    return Forward(
        torch.cat((mean.unsqueeze(-2), filtered.mean), -2),
        torch.cat((covariance.unsqueeze(-3), filtered.covariance), -3),
        filtered.prior_mean,
        steps.transition,
        steps.noise,
    )


def smoother_gain(covariance: Tensor, transition: Tensor, noise: Tensor) -> Tensor:
    """Return the gain G = P Φᵀ (Φ P Φᵀ + Q)⁺ by which a later belief corrects an earlier one.

    [Sarkka2013] Theorem 8.2. The predicted covariance is scaled to unit diagonal, solved with a
    tiny ridge and once refined, which takes the ridge's bias away and leaves the least solution
    where the covariance is singular (a state without variance and without noise).

    Args:
        covariance: P after the update, shape (..., n, n).
        transition: Φ of the next step, shape (..., n, n).
        noise: Q of the next step, shape (..., n, n).

    Returns:
        G, shape (..., n, n).
    """
    predicted = propagated(covariance, transition, noise)
    variance = predicted.diagonal(dim1=-2, dim2=-1)
    scale = torch.where(variance > 0.0, variance, 1.0).sqrt()
    correlation = predicted / (scale.unsqueeze(-1) * scale.unsqueeze(-2))
    cross = (transition @ covariance) / scale.unsqueeze(-1)
    eye = torch.eye(scale.shape[-1], dtype=scale.dtype, device=scale.device)
    factor = torch.linalg.cholesky_ex(correlation + RIDGE * eye)[0]
    solved = torch.cholesky_solve(cross, factor)
    solved = solved + torch.cholesky_solve(cross - correlation @ solved, factor)
    return (solved / scale.unsqueeze(-1)).transpose(-1, -2)


def smooth_in_turn(forward: Forward) -> Smoothed:
    """Smooth one step after another, from the last to the first.

    [Sarkka2013] Theorem 8.2.

    Args:
        forward: What the filter left.

    Returns:
        Means, covariances and gains.
    """
    gain, left = _gains(forward)
    mean, covariance = forward.mean[..., -1, :], forward.covariance[..., -1, :, :]
    means, covariances = [mean], [covariance]
    # unbind: indexing inside a loop would make the backward pass quadratic
    steps = zip(
        gain.unbind(-3),
        left.unbind(-3),
        forward.mean.unbind(-2),
        forward.ahead.unbind(-2),
        strict=False,
    )
    for G, L, here, ahead in reversed(list(steps)):
        mean = here + _times(G, mean - ahead)
        covariance = symmetrized(L + G @ covariance @ G.transpose(-1, -2))
        means.append(mean)
        covariances.append(covariance)
    return Smoothed(torch.stack(means[::-1], -2), torch.stack(covariances[::-1], -3), gain)


def smooth_in_parallel(forward: Forward, chunk: int | None = None) -> Smoothed:
    """Smooth all stretches of steps side by side; equals :func:`smooth_in_turn`.

    [Sarkka2021] §IV-B.

    Args:
        forward: What the filter left.
        chunk: Steps per stretch; None chooses about √K.

    Returns:
        Means, covariances and gains.
    """
    count = forward.ahead.shape[-2]
    size = chunk or max(1, round(math.sqrt(count)))
    chunks = -(-count // size)
    if chunks <= 1:
        return smooth_in_turn(forward)
    gain, left = _gains(forward)
    shift = forward.mean[..., :-1, :] - _times(gain, forward.ahead)
    gains, shifts, lefts = _in_chunks(gain, shift, left, size, chunks)
    A, b, C = _composed(gains, shifts, lefts)
    mean, covariance = forward.mean[..., -1, :], forward.covariance[..., -1, :, :]
    means, covariances = [mean], [covariance]
    firsts = zip(
        A[..., 0, :, :].unbind(-3), b[..., 0, :].unbind(-2), C[..., 0, :, :].unbind(-3), strict=True
    )
    for E, g, L in reversed(list(firsts)[1:]):
        mean, covariance = _times(E, mean) + g, _carried(E, covariance, L)
        means.append(mean)
        covariances.append(covariance)
    later = torch.stack(means[::-1], -2).unsqueeze(-2)
    spread = torch.stack(covariances[::-1], -3).unsqueeze(-3)
    found = (_times(A, later) + b).flatten(-3, -2)[..., :count, :]
    P = _carried(A, spread, C).flatten(-4, -3)[..., :count, :, :]
    return Smoothed(
        torch.cat((found, forward.mean[..., -1:, :]), -2),
        torch.cat((P, forward.covariance[..., -1:, :, :]), -3),
        gain,
    )


def _gains(forward: Forward) -> tuple[Tensor, Tensor]:
    """Return G and L of all steps."""
    P = forward.covariance[..., :-1, :, :]
    gain = smoother_gain(P, forward.transition, forward.noise)
    eye = torch.eye(P.shape[-1], dtype=P.dtype, device=P.device)
    kept = eye - gain @ forward.transition
    own = kept @ P @ kept.transpose(-1, -2)
    return gain, symmetrized(own + gain @ forward.noise @ gain.transpose(-1, -2))


def _composed(gains: Tensor, shifts: Tensor, lefts: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Compose, in every stretch, each step with all that follow it there."""
    A, b, C = gains[..., -1, :, :], shifts[..., -1, :], lefts[..., -1, :, :]
    done = [(A, b, C)]
    steps = list(zip(gains.unbind(-3), shifts.unbind(-2), lefts.unbind(-3), strict=True))
    for E, g, L in reversed(steps[:-1]):
        A, b, C = E @ A, _times(E, b) + g, _carried(E, C, L)
        done.append((A, b, C))
    As, bs, Cs = zip(*reversed(done), strict=True)
    return torch.stack(As, -3), torch.stack(bs, -2), torch.stack(Cs, -3)


def _in_chunks(
    gain: Tensor, shift: Tensor, left: Tensor, size: int, chunks: int
) -> tuple[Tensor, Tensor, Tensor]:
    n, missing = shift.shape[-1], size * chunks - shift.shape[-2]
    eye = torch.eye(n, dtype=gain.dtype, device=gain.device)
    same = eye.expand(*gain.shape[:-3], missing, n, n)
    batch = gain.shape[:-3]
    return (
        torch.cat((gain, same), -3).reshape(*batch, chunks, size, n, n),
        torch.nn.functional.pad(shift, (0, 0, 0, missing)).reshape(*batch, chunks, size, n),
        torch.nn.functional.pad(left, (0, 0, 0, 0, 0, missing)).reshape(*batch, chunks, size, n, n),
    )


def _carried(gain: Tensor, covariance: Tensor, left: Tensor) -> Tensor:
    return symmetrized(gain @ covariance @ gain.transpose(-1, -2) + left)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
