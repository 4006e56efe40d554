"""Work over all blocks, some at a time, so that what is made on the way stays near at hand."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import torch
from torch import Tensor

from navlearn.filters.tight_belief import map_tree

T = TypeVar("T")
Carried = Callable[[Any, Tensor, Any], T]


def in_stretches(carry: Carried[T], at_once: int) -> Carried[T]:
    """Return what carries points over some blocks at a time where no gradient is asked for.

    Args:
        carry: What carries them: takes beliefs at the starts of blocks, points about them and the
            blocks.
        at_once: Samples of all drives over which it may at once.
    """

    def some_at_a_time(begin: Any, deviation: Tensor, blocks: Any) -> T:
        drives, count, samples = blocks.samples.dt.shape
        size = max(1, at_once // (drives * samples))
        if torch.is_grad_enabled() or size >= count:
            return carry(begin, deviation, blocks)
        parts = [
            carry(*map_tree((begin, deviation, blocks), partial(_stretch, first=k, size=size)))
            for k in range(0, count, size)
        ]
        whole: T = joined(parts)
        return whole

    return some_at_a_time


def joined(trees: list[Any]) -> Any:
    """Return trees of tensors, one after another along their blocks.

    Args:
        trees: Trees of tuples of tensors and None, shape (B, K, ...) each.

    Returns:
        The same tree, K summed up.
    """
    first = trees[0]
    if first is None:
        return None
    if isinstance(first, Tensor):
        return torch.cat(trees, 1)
    parts = [joined(list(branches)) for branches in zip(*trees, strict=True)]
    return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)


def _stretch(x: Tensor, first: int, size: int) -> Tensor:
    return x[:, first : first + size]
