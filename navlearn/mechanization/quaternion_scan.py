"""Prefix products of many quaternions, few operations and none of them small.

Records are cut into rows of sixteen (short ones of √n): the products inside all rows are formed
step by step, side by side; those of whole rows are the same task again, a sixteenth as long; then
both are joined. What is left of a few hundred is done by doubling. Channels lie as separate
tensors.
"""

import math

import torch
from torch import Tensor

Quaternion = tuple[Tensor, Tensor, Tensor, Tensor]

ROW = 16
"""Quaternions that are multiplied one after another, at most."""

FEW = 1024
"""Elements up to which doubling costs less than rows."""


def product(left: Quaternion, right: Quaternion) -> Quaternion:
    """Return the Hamilton product of quaternions whose components are separate tensors.

    Args:
        left: Scalar-first components, shape (...) each.
        right: The same.

    Returns:
        left ⊗ right, shape (...) each.
    """
    a, b, c, d = left
    e, f, g, h = right
    more, less = torch.addcmul, _less
    return (
        less(less(less(a * e, b, f), c, g), d, h),
        less(more(more(a * f, b, e), c, h), d, g),
        more(more(less(a * g, b, h), c, e), d, f),
        more(less(more(a * h, b, g), c, f), d, e),
    )


def scanned_products(turns: Quaternion) -> Quaternion:
    """Return the products q_1, q_1 q_2, … of each record.

    Args:
        turns: Scalar-first components of n successive rotations, shape (N, n) each.

    Returns:
        Products up to and with each, shape (N, n) each.
    """
    records, n = turns[0].shape
    if n <= 1:
        return _of([x.clone() for x in turns])
    if records * n <= FEW or n <= ROW:
        return _doubled(turns)
    size = min(ROW, math.isqrt(n))
    rows = -(-n // size)
    laid = [_laid(x, rows, size, 1.0 if k == 0 else 0.0) for k, x in enumerate(turns)]
    inside = [_of([x[0] for x in laid])]
    for step in list(zip(*laid, strict=True))[1:]:
        inside.append(product(inside[-1], _of(step)))
    whole = scanned_products(inside[-1])
    before = _of([_shifted(x, 1.0 if k == 0 else 0.0) for k, x in enumerate(whole)])
    joined = product(before, _of([torch.stack(x) for x in zip(*inside, strict=True)]))
    flat = [x.permute(1, 2, 0).reshape(records, rows * size) for x in joined]
    return _of([x if x.shape[1] == n else x[:, :n].contiguous() for x in flat])


def _doubled(turns: Quaternion) -> Quaternion:
    """Form products over one, two, four, … neighbours."""
    reach, n = 1, turns[0].shape[-1]
    while reach < n:
        later = product(_of([x[:, : n - reach] for x in turns]), _of([x[:, reach:] for x in turns]))
        turns = _of([torch.cat((x[:, :reach], y), -1) for x, y in zip(turns, later, strict=True)])
        reach *= 2
    return turns


def _laid(channel: Tensor, rows: int, size: int, fill: float) -> tuple[Tensor, ...]:
    """Return a channel as ``size`` tensors (N, rows): what is done at one time lies together."""
    records, n = channel.shape
    if rows * size > n:
        channel = torch.nn.functional.pad(channel, (0, rows * size - n), value=fill)
    steps: tuple[Tensor, ...] = (
        channel.view(records, rows, size).permute(2, 0, 1).contiguous().unbind(0)
    )
    return steps


def _shifted(channel: Tensor, fill: float) -> Tensor:
    return torch.nn.functional.pad(channel[:, :-1], (1, 0), value=fill)


def _less(total: Tensor, left: Tensor, right: Tensor) -> Tensor:
    return torch.addcmul(total, left, right, value=-1.0)


def _of(parts: "list[Tensor] | tuple[Tensor, ...]") -> Quaternion:
    w, x, y, z = parts
    return w, x, y, z
