"""Beliefs and blocks are trees of named tuples: one block of many, or all once per point."""

from typing import Any, TypeVar

from torch import Tensor

T = TypeVar("T")


def block_at(blocks: T, k: int) -> T:
    """Return one of all blocks, batch shape (B,).

    Args:
        blocks: Tree of named tuples of tensors, shape (B, K, ...) each.
        k: Which.
    """
    if isinstance(blocks, Tensor):
        return blocks[:, k]  # type: ignore[return-value]
    parts: Any = blocks
    return type(blocks)(*(block_at(part, k) for part in parts))


def for_points(tree: T, batch: int, points: int) -> T:
    """Return beliefs or blocks once for each of several points, as views.

    Args:
        tree: Tree of named tuples of tensors and None, batch shape (...).
        batch: Number of batch axes.
        points: Number of points P.

    Returns:
        The same of batch shape (..., P).
    """
    if tree is None:
        return tree
    if isinstance(tree, Tensor):
        shape = tree.shape
        wide = tree.unsqueeze(batch).expand(*shape[:batch], points, *shape[batch:])
        return wide  # type: ignore[return-value]
    parts: Any = tree
    return type(tree)(*(for_points(part, batch, points) for part in parts))
