"""Products of many small rotations, all windows side by side.

Channels lie as separate tensors: a quaternion product is then sixteen fused products along
contiguous memory. A window of n rotations is cut into about √n chunks; the products inside all
chunks are formed step by step, then those over chunks, then both are joined: two products per
sample instead of log₂ n.
"""

import math

import torch
from torch import Tensor

Quaternion = tuple[Tensor, Tensor, Tensor, Tensor]


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


def quaternions_of(rotation: Tensor) -> Quaternion:
    """Return the quaternions of small rotation vectors, smooth at zero.

    Args:
        rotation: Axis times angle, rad, shape (3, ...).

    Returns:
        Scalar-first components, shape (...) each.
    """
    x, y, z = rotation.unbind(0)
    # below 1e-8 rad the sine is its argument to rounding; the root keeps its derivative finite
    angle = torch.sqrt(torch.addcmul(torch.addcmul(torch.addcmul(_tiny(x), x, x), y, y), z, z))
    half = 0.5 * angle
    ratio = torch.sin(half) / angle
    return torch.cos(half), x * ratio, y * ratio, z * ratio


def prefix_products(turns: Quaternion) -> Quaternion:
    """Return the products q_1, q_1 q_2, … of each window.

    Args:
        turns: Quaternions of n successive rotations, shape (N, n) each.

    Returns:
        Products up to and with each, shape (N, n) each.
    """
    windows, n = turns[0].shape
    size = max(1, math.isqrt(n))
    chunks = -(-n // size)
    laid = [_laid(x, size, chunks, 1.0 if k == 0 else 0.0) for k, x in enumerate(turns)]
    inside = _in_turn([_of(x) for x in zip(*(x.unbind(0) for x in laid), strict=True)])
    whole = [x.unbind(-1) for x in inside[-1]]
    one, zero = torch.ones_like(whole[0][0]), torch.zeros_like(whole[0][0])
    over = [_of(x) for x in zip(*whole, strict=True)][:-1]
    before = _in_turn([(one, zero, zero, zero), *over])
    start = _of([torch.stack(x, -1) for x in zip(*before, strict=True)])
    joined = product(start, _of([torch.stack(x, 0) for x in zip(*inside, strict=True)]))
    return _of([x.permute(1, 2, 0).reshape(windows, chunks * size)[:, :n] for x in joined])


def _less(total: Tensor, left: Tensor, right: Tensor) -> Tensor:
    return torch.addcmul(total, left, right, value=-1.0)


def _tiny(like: Tensor) -> Tensor:
    return torch.full((), 1e-16, dtype=like.dtype, device=like.device)


def _of(parts: "list[Tensor] | tuple[Tensor, ...]") -> Quaternion:
    w, x, y, z = parts
    return w, x, y, z


def _laid(channel: Tensor, size: int, chunks: int, fill: float) -> Tensor:
    """Return a channel as (size, N, chunks): what is done at one time lies together."""
    windows, n = channel.shape
    if chunks * size > n:
        channel = torch.nn.functional.pad(channel, (0, chunks * size - n), value=fill)
    return channel.view(windows, chunks, size).permute(2, 0, 1).contiguous()


def _in_turn(turns: list[Quaternion]) -> list[Quaternion]:
    done = [turns[0]]
    for turn in turns[1:]:
        done.append(product(done[-1], turn))
    return done
