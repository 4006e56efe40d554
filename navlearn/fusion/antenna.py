"""Where the GNSS antenna of a RISS car is against the navigating point, and how fast it moves.

[Noureldin2013] §8.3. Fixes and single ranges see the same antenna; both are measured against this.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.fusion.error_state import ErrorLayout
from navlearn.fusion.ground_velocity import GroundVelocity, Odometry, ground_velocity
from navlearn.fusion.lever_arm import LeverArm, arm_columns
from navlearn.fusion.sensor_errors import SensorErrors


class AntennaMotion(NamedTuple):
    """A vector of the antenna and its derivative.

    Attributes:
        value: East, north, up, shape (..., 3): its way from the navigating point at the end of a
            block, m, or its velocity, m/s.
        by_error: Change per correction of the antenna's position or velocity, shape (..., 3, n).
    """

    value: Tensor
    by_error: Tensor


class CarAtEnd(NamedTuple):
    """A car at the ends of blocks, as far as its antenna's motion hangs on it.

    Attributes:
        errors: Sensor parameters of the filter.
        layout: Order of the error states.
        belief: Belief at the end, batch shape (...).
        told: What the last sample says.
        arm: Lever arm, or None where there is none.
    """

    errors: SensorErrors
    layout: ErrorLayout
    belief: Belief
    told: Odometry
    arm: LeverArm | None

    def moving(self, lag: Tensor) -> GroundVelocity:
        """Return the velocity of the navigating point a moment before the end.

        Args:
            lag: How long before, s, shape (...).
        """
        azimuth, offset = self.belief.state.azimuth, self.belief.velocity_offset
        return ground_velocity(self.errors, self.told, azimuth, offset, lag)


def antenna_offset(car: CarAtEnd, lag: Tensor) -> AntennaMotion:
    """Return where the antenna was a moment before the end of a block, from the car at the end.

    Args:
        car: The car at the end, batch shape (...).
        lag: How long before the end, s, shape (...).

    Returns:
        Offset, batch shape (...).
    """
    unit = torch.eye(3, dtype=lag.dtype, device=lag.device).expand(*lag.shape, 3, 3)
    by_error = torch.nn.functional.pad(unit, (0, car.layout.size - 3))
    offset = torch.zeros_like(by_error[..., 0])
    if lag.requires_grad or bool((lag != 0.0).any()):
        moved = car.moving(0.5 * lag)
        back = lag.unsqueeze(-1)
        offset = offset - back * moved.velocity
        by_error = by_error - back.unsqueeze(-1) * moved.by_error
    if car.arm is not None:
        offset = offset + car.arm.arm
        by_error = by_error + arm_columns(car.layout, car.errors, car.arm)
    return AntennaMotion(offset, by_error)


def antenna_velocity(car: CarAtEnd, lag: Tensor) -> AntennaMotion:
    """Return the velocity of the antenna a moment before the end of a block.

    Args:
        car: The car at the end, batch shape (...).
        lag: How long before the end, s, shape (...).

    Returns:
        Velocity and its change per correction, batch shape (...).
    """
    now, told, arm, layout = car.moving(lag), car.told, car.arm, car.layout
    if arm is None:
        return AntennaMotion(*now)
    rate = told.turn.rate.unsqueeze(-1)
    swing = arm.by_azimuth.unsqueeze(-1) * told.turn.by_error.unsqueeze(-2)
    e, n, _ = arm.arm.unbind(-1)
    inwards = -rate * torch.stack((e, n, torch.zeros_like(e)), -1)
    by_error = now.by_error + swing
    if car.errors.pitch_bias:
        tip_e, tip_n, _ = arm.by_pitch_bias.unbind(-1)
        tipped = torch.stack((tip_n, -tip_e, torch.zeros_like(e)), -1)
        column = (rate * tipped).unsqueeze(-1)
        by_error = by_error + torch.nn.functional.pad(column, (layout.size - 1, 0))
    at = layout.azimuth
    by_error = by_error + torch.nn.functional.pad(inwards.unsqueeze(-1), (at, layout.size - at - 1))
    return AntennaMotion(now.velocity + rate * arm.by_azimuth, by_error)
