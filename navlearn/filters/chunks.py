"""Filtering over long time in chunks of about √K steps, side by side.

Särkkä and García-Fernández 2021, Temporal parallelization of Bayesian smoothers, §IV: a stretch
of steps is summed up as an element (what the stretch says of its start, and what it makes of it),
and elements compose. All chunks are summed up side by side, the few sums are composed one after
another, and all chunks are then filtered side by side from their right starts. That is
2√K + K/√K short vectorised steps instead of K. How a step is written down is left to the caller.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor

from navlearn.filters.ekf import symmetrized

Steps = TypeVar("Steps", bound=tuple[Any, ...])

WIDE = 16
"""Batch from which one step after another is faster than summing up chunks first."""

MATRICES = ("transition", "noise", "observation", "information")
"""Fields of steps that are matrices; the others are vectors."""


class Filtered(NamedTuple):
    """Means and covariances of all steps.

    Attributes:
        prior_mean: Before the update, shape (..., K, n).
        prior_covariance: Before the update, shape (..., K, n, n).
        mean: After the update, shape (..., K, n).
        covariance: After the update, shape (..., K, n, n).
    """

    prior_mean: Tensor
    prior_covariance: Tensor
    mean: Tensor
    covariance: Tensor


class Element(NamedTuple):
    """A chunk summed up: end = A start + b + N(0, C), and of the start η, J (information).

    Attributes:
        A: Shape (..., n, n).
        b: Shape (..., n).
        C: Shape (..., n, n).
        eta: Shape (..., n).
        J: Shape (..., n, n).
    """

    A: Tensor
    b: Tensor
    C: Tensor
    eta: Tensor
    J: Tensor


def filter_chunks(
    mean: Tensor,
    covariance: Tensor,
    steps: Steps,
    chunk: int | None,
    summed: Callable[[Steps], Element],
    filtered: Callable[[Tensor, Tensor, Steps], Filtered],
) -> Filtered:
    """Filter all chunks of steps side by side.

    Args:
        mean: Mean before the first step, shape (..., n).
        covariance: Covariance before the first step, shape (..., n, n).
        steps: The system, a named tuple with ``transition``, shape (..., K, n, n); fields named in
            ``MATRICES`` have two axes after K, the others one.
        chunk: Steps per chunk; None chooses about √K, or one chunk where the batch is so large
            that a step is work enough.
        summed: Sums up chunks of steps, batch shape (..., chunks).
        filtered: Filters chunks of steps one step after another.

    Returns:
        Means and covariances.
    """
    count = steps.transition.shape[-3]  # type: ignore[attr-defined]
    wide = mean.numel() // mean.shape[-1] >= WIDE
    size = chunk or (count if wide else max(1, round(math.sqrt(count))))
    chunks = -(-count // size)
    if chunks == 1:
        return filtered(mean, covariance, steps)
    laid = in_chunks(steps, size, chunks)
    along = mean.dim() - 1
    sums = summed(type(steps)(*(x.narrow(along, 0, chunks - 1) for x in laid)))
    means, covariances = [mean], [covariance]
    for element in zip(
        sums.A.unbind(-3),
        sums.b.unbind(-2),
        sums.C.unbind(-3),
        sums.eta.unbind(-2),
        sums.J.unbind(-3),
        strict=True,
    ):
        mean, covariance = through(mean, covariance, Element(*element))
        means.append(mean)
        covariances.append(covariance)
    done = filtered(torch.stack(means, -2), torch.stack(covariances, -3), laid)
    return Filtered(*(x.flatten(along, along + 1).narrow(along, 0, count) for x in done))


def in_chunks(steps: Steps, size: int, chunks: int) -> Steps:
    """Return steps cut into chunks; the last is filled up with steps that change nothing.

    Args:
        steps: The system, shape (..., K, ...) each.
        size: Steps per chunk.
        chunks: Number of chunks.

    Returns:
        Shape (..., chunks, size, ...) each.
    """
    names: tuple[str, ...] = type(steps)._fields  # type: ignore[attr-defined]
    count, n = steps.transition.shape[-3], steps.transition.shape[-1]  # type: ignore[attr-defined]
    missing = size * chunks - count

    def cut(name: str, x: Tensor) -> Tensor:
        along = -3 if name in MATRICES else -2
        if missing > 0 and name == "transition":
            eye = torch.eye(n, dtype=x.dtype, device=x.device)
            x = torch.cat((x, eye.expand(*x.shape[:-3], missing, n, n)), -3)
        elif missing > 0:
            widths = (*([0] * (-2 * along - 2)), 0, missing)
            x = torch.nn.functional.pad(x, widths, value=1.0 if name == "variance" else 0.0)
        shape = list(x.shape)
        shape[along : along + 1] = [chunks, size]
        return x.reshape(shape)

    return type(steps)(*(cut(name, x) for name, x in zip(names, steps, strict=True)))


def through(mean: Tensor, covariance: Tensor, e: Element) -> tuple[Tensor, Tensor]:
    """Return mean and covariance at the end of a chunk that has been summed up.

    Args:
        mean: Mean at its start, shape (..., n).
        covariance: Covariance there, shape (..., n, n).
        e: The chunk.
    """
    n = mean.shape[-1]
    eye = torch.eye(n, dtype=mean.dtype, device=mean.device)
    right = torch.cat(
        ((mean + (covariance @ e.eta.unsqueeze(-1)).squeeze(-1)).unsqueeze(-1), covariance), -1
    )
    start = torch.linalg.solve(eye + covariance @ e.J, right)
    after = e.A @ start
    P = after[..., 1:] @ e.A.transpose(-1, -2) + e.C
    return after[..., 0] + e.b, symmetrized(P)
