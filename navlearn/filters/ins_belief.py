"""What a full-IMU filter believes between two steps: an estimate and its covariance."""

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from navlearn.states import InsState


class InsBelief(NamedTuple):
    """Estimate of the car and of its inertial sensors, and how far it is trusted.

    The covariance is that of the error (estimate minus truth): position east, north, up (m);
    velocity east, north, up (m/s); attitude φ about east, north, up (rad), the small rotation in
    Ĉ_lb = (I + [φ×]) C_lb; then the sensor parameters. An azimuth error is −φ_up, because azimuth
    counts clockwise.

    Attributes:
        state: Position, velocity and attitude, shape (...) and (..., 3), (..., 4).
        sensor: Estimated sensor parameters: gyro bias x, y, z (rad/s), accelerometer bias x, y, z
            (m/s²), and what else the filter's options add, in their order, shape (..., m).
        covariance: Covariance of the error, shape (..., 9 + m, 9 + m).
        refused: Consecutive refusals by the gate per kind of measurement, shape (..., kinds).
    """

    state: InsState
    sensor: Tensor
    covariance: Tensor
    refused: Tensor


def map_ins_belief(belief: InsBelief, function: Callable[[Tensor], Tensor]) -> InsBelief:
    """Return a belief with a function applied to every tensor.

    Args:
        belief: Belief.
        function: What to do with each tensor.

    Returns:
        Belief.
    """
    return InsBelief(InsState(*map(function, belief.state)), *map(function, belief[1:]))
