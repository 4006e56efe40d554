"""One drive as a batch of one, and back; and whether anything in it asks for gradients."""

from collections.abc import Iterable

from torch import Tensor


def unsqueezed(x: Tensor) -> Tensor:
    """Return a tensor with a batch axis of one in front, shape (1, ...).

    Args:
        x: Shape (...).
    """
    return x.unsqueeze(0)


def first(x: Tensor) -> Tensor:
    """Return the first of a batch, shape (...).

    Args:
        x: Shape (B, ...).
    """
    return x[0]


def wants_gradient(leaves: Iterable[Tensor]) -> bool:
    """Return whether any of some tensors asks for gradients.

    Args:
        leaves: The tensors.
    """
    return any(leaf.requires_grad for leaf in leaves)
