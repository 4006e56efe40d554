"""Products of many small rotations, all windows side by side.

Channels lie as separate tensors: a quaternion product is then sixteen fused products along
contiguous memory. A window of n rotations is cut into about √n chunks; the products inside all
chunks are formed step by step, then those over chunks, then both are joined: two products per
sample instead of log₂ n. Derivatives need no recursion at all: what a small change of one rotation
does to all later products is one rotation seen from the start, so they are cumulative sums.
"""

import math

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

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
        turns: Unit quaternions of n successive rotations, shape (N, n) each.

    Returns:
        Products up to and with each, shape (N, n) each.
    """
    return _of(_Products.apply(*turns))  # type: ignore[no-untyped-call]


class _Products(torch.autograd.Function):
    """Prefix products with the derivatives that unit quaternions allow.

    q_k = q_{j−1} d_j (d_{j+1} … d_k), and the last factor is q_j* q_k where all are unit.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(w: Tensor, x: Tensor, y: Tensor, z: Tensor) -> Quaternion:
        return _products((w, x, y, z))

    @staticmethod
    def setup_context(ctx: FunctionCtx, _: Quaternion, output: Quaternion) -> None:
        ctx.save_for_backward(*output)
        ctx.save_for_forward(*output)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor) -> Quaternion:
        q = _of(ctx.saved_tensors)  # type: ignore[attr-defined]
        told = product(_of(grads), conjugate(q))
        later = _of([x.flip(-1).cumsum(-1).flip(-1) for x in told])
        return product(product(conjugate(_before(q)), later), q)

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor) -> Quaternion:
        q = _of(ctx.saved_tensors)  # type: ignore[attr-defined]
        moved = product(product(_before(q), _of(tangents)), conjugate(q))
        return product(_of([x.cumsum(-1) for x in moved]), q)


def conjugate(q: Quaternion) -> Quaternion:
    """Return the conjugates of quaternions, the inverses of unit ones.

    Args:
        q: Scalar-first components, shape (...) each.

    Returns:
        The same with the vector part turned round.
    """
    return q[0], -q[1], -q[2], -q[3]


def _before(q: Quaternion) -> Quaternion:
    """Return the product before each sample, one before the first."""
    first = torch.ones_like(q[0][:, :1])
    return _of([torch.cat((first * (k == 0), x[:, :-1]), -1) for k, x in enumerate(q)])


def _products(turns: Quaternion) -> Quaternion:
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
    flat = [x.permute(1, 2, 0).reshape(windows, chunks * size) for x in joined]
    # outputs of a function of one's own must be no views
    return _of([x if x.shape[1] == n else x[:, :n].clone() for x in flat])


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
