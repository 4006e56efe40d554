"""What a navigation filter believes between two steps: an estimate and its covariance."""

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from navlearn.states import NavState


class Belief(NamedTuple):
    """Estimate of the car, of its sensors, and how far it is trusted.

    The covariance is that of the error (estimate minus truth) in the order of the error model:
    east, north, up (m), [velocity east, north, up (m/s)], azimuth (rad), sensor parameters.

    Attributes:
        state: Position and azimuth, shape (...) each.
        sensor: Estimated sensor parameters, in the error model's order and units, shape (..., m).
        velocity_offset: Estimated velocity minus what odometer and azimuth say, ENU, m/s, shape
            (..., 3); stays zero in models without velocity states.
        covariance: Covariance of the error, shape (..., n, n).
        anchor: Sensor parameters at alignment, to which a Gauss–Markov bias returns, shape
            (..., m).
        refused: Consecutive refusals by the gate per kind of measurement, shape (..., 5).
    """

    state: NavState
    sensor: Tensor
    velocity_offset: Tensor
    covariance: Tensor
    anchor: Tensor
    refused: Tensor


def map_belief(belief: Belief, function: Callable[[Tensor], Tensor]) -> Belief:
    """Return a belief with a function applied to every tensor.

    Args:
        belief: Belief.
        function: What to do with each tensor.

    Returns:
        Belief.
    """
    return Belief(NavState(*map(function, belief.state)), *map(function, belief[1:]))
