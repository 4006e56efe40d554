"""Products of many small rotations, all windows side by side.

Channels lie as separate tensors: a quaternion product is then sixteen fused products along
contiguous memory. Derivatives of prefix products need no recursion: what a small change of one
rotation does to all later products is one rotation seen from the start, so they are cumulative
sums.
"""

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from navlearn.mechanization.quaternion_scan import Quaternion as Quaternion
from navlearn.mechanization.quaternion_scan import product as product
from navlearn.mechanization.quaternion_scan import scanned_products


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
        return scanned_products((w, x, y, z))

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


def _tiny(like: Tensor) -> Tensor:
    return torch.full((), 1e-16, dtype=like.dtype, device=like.device)


def _of(parts: "list[Tensor] | tuple[Tensor, ...]") -> Quaternion:
    w, x, y, z = parts
    return w, x, y, z
