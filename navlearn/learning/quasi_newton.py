"""A quasi-Newton search in a few parameters that may be interrupted and gone on with.

BFGS with backtracking, [Nocedal2006] Algorithms 3.1 and 6.1. The function may refuse a point by
returning infinity: the step is then halved.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

SUFFICIENT = 1e-4
"""Share of the decrease promised by the slope that a step must bring."""

SHORTEST = 1e-4
"""Steps shorter than this are not tried."""


class Point(NamedTuple):
    """A point with what the function is there.

    Attributes:
        x: Shape (P,).
        value: The function.
        gradient: Shape (P,).
    """

    x: Tensor
    value: float
    gradient: Tensor


Function = Callable[[Tensor], Point]


def first_inverse(point: Point) -> Tensor:
    """Return an inverse Hessian whose first step moves the steepest parameter by one.

    Args:
        point: Where the search begins.

    Returns:
        Shape (P, P).
    """
    steepest = float(point.gradient.abs().max())
    eye = torch.eye(point.x.shape[0], dtype=point.x.dtype)
    return eye / max(steepest, 1.0)


def quasi_newton_step(
    function: Function, point: Point, inverse: Tensor, longest: float
) -> tuple[Point, Tensor] | None:
    """Return the next point and inverse Hessian.

    Args:
        function: What is minimised.
        point: Present point.
        inverse: Present inverse Hessian, shape (P, P).
        longest: Longest step of any parameter.

    Returns:
        The next, or None where no step goes downhill.
    """
    direction = -inverse @ point.gradient
    slope = float(direction @ point.gradient)
    if slope >= 0.0:
        inverse = first_inverse(point)
        direction = -inverse @ point.gradient
        slope = float(direction @ point.gradient)
    length = float(direction.abs().max())
    if length == 0.0:
        return None
    share = min(1.0, longest / length)
    while share * length > SHORTEST:
        new = function(point.x + share * direction)
        if new.value <= point.value + SUFFICIENT * share * slope:
            return new, _updated(inverse, new.x - point.x, new.gradient - point.gradient)
        share *= _shrink(point.value, new.value, slope, share)
    return None


def _shrink(before: float, after: float, slope: float, share: float) -> float:
    """Return the factor to the minimum of the parabola through what is known."""
    if not math.isfinite(after):
        return 0.25
    bend = 2.0 * (after - before - share * slope)
    return min(max(-slope * share / bend, 0.1), 0.5) if bend > 0.0 else 0.5


def _updated(inverse: Tensor, step: Tensor, change: Tensor) -> Tensor:
    curvature = float(step @ change)
    if curvature <= 1e-10 * float(step.norm() * change.norm()):
        return inverse
    eye = torch.eye(step.shape[0], dtype=step.dtype)
    left = eye - torch.outer(step, change) / curvature
    return left @ inverse @ left.T + torch.outer(step, step) / curvature
