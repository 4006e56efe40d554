"""What a tightly coupled filter believes: a vehicle and a receiver's clock."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.ins_belief import InsBelief

AnyBelief = TypeVar("AnyBelief", Belief, InsBelief)


class TightBelief(NamedTuple, Generic[AnyBelief]):
    """Estimate of a vehicle and of the clock of its receiver, and how far it is trusted.

    The covariance is that of the error (estimate minus truth): the vehicle's n error states in
    their own order, then the c clock states.

    Attributes:
        vehicle: The vehicle's belief; its own covariance is the upper left block of the whole.
        clock: Receiver clock ahead of the first system's time, times the speed of light, m; its
            drift, m/s; then the time of each further system ahead of the first, m. Shape (..., c).
        covariance: Covariance of the whole error, shape (..., n + c, n + c).
        refused: Consecutive refusals by the gate, pseudoranges then range rates of each satellite;
            then consecutive receptions many of whose pseudoranges, and many of whose range rates,
            were refused, shape (..., 2 S + 2).
    """

    vehicle: AnyBelief
    clock: Tensor
    covariance: Tensor
    refused: Tensor


def map_tight_belief(
    belief: TightBelief[AnyBelief], function: Callable[[Tensor], Tensor]
) -> TightBelief[AnyBelief]:
    """Return a belief with a function applied to every tensor.

    Args:
        belief: Belief.
        function: What to do with each tensor.

    Returns:
        Belief.
    """
    mapped: TightBelief[AnyBelief] = map_tree(belief, function)
    return mapped


def map_tree(tree: Any, function: Callable[[Tensor], Tensor]) -> Any:
    """Return nested tuples, named or not, with a function applied to every tensor; the rest stays.

    Args:
        tree: Nested tuples.
        function: What to do with each tensor.

    Returns:
        The same nesting.
    """
    if isinstance(tree, Tensor):
        return function(tree)
    if isinstance(tree, tuple):
        parts = (map_tree(part, function) for part in tree)
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    return tree
