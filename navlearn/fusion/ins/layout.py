"""The order of the error states of a full-IMU filter, and how an error moves an estimate.

Errors are estimate minus truth: metres and m/s east, north, up; the small rotation φ about east,
north, up in Ĉ_lb = (I + [φ×]) C_lb; then sensor parameters. An azimuth error is −φ_up.
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from navlearn.attitude import quaternion_from_rotation_vector, quaternion_multiply
from navlearn.filters.ins_belief import InsBelief
from navlearn.frames import enu_between, shift_between, shift_geodetic
from navlearn.fusion.ins.imu_errors import ImuErrors, SensorStates, errors_of
from navlearn.fusion.ins.imu_errors import imu_corrected as imu_corrected
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.states import InsState

INS_ERROR_UNITS: Final[dict[str, str]] = {
    **dict.fromkeys(("east", "north", "up"), "m"),
    **dict.fromkeys(("v_east", "v_north", "v_up"), "m/s"),
    **dict.fromkeys(("phi_east", "phi_north", "phi_up"), "rad"),
    **dict.fromkeys((f"gyro_bias_{axis}" for axis in "xyz"), "rad/s"),
    **dict.fromkeys((f"accel_bias_{axis}" for axis in "xyz"), "m/s²"),
    **dict.fromkeys((f"{kind}_scale_{axis}" for kind in ("gyro", "accel") for axis in "xyz"), "1"),
    "odometer_scale": "1",
}
"""Units of the errors, by name."""


@dataclass(frozen=True)
class InsLayout:
    """Where each error stands in the error state.

    Attributes:
        names: Name of each error, in order.
        states: 9, 15 or 21: what of the IMU's errors is a state.
        odometer_scale: Whether the last state is the odometer's scale error.
    """

    names: tuple[str, ...]
    states: int
    odometer_scale: bool

    @property
    def size(self) -> int:
        """Number of error states n."""
        return len(self.names)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensor parameters, in order."""
        return self.names[9:]

    @property
    def has_bias(self) -> bool:
        """Whether gyro and accelerometer biases are states."""
        return self.states >= 15

    @property
    def has_scale(self) -> bool:
        """Whether gyro and accelerometer scale factors are states."""
        return self.states >= 21

    @property
    def sensor_states(self) -> SensorStates:
        """Which sensor errors are states."""
        return SensorStates(self.has_bias, self.has_scale, self.odometer_scale)

    def of(self, group: str) -> list[int]:
        """Return the places of a group (``gyro_bias``) or of one error (``gyro_bias_x``)."""
        return [k for k, n in enumerate(self.names) if n == group or n[:-2] == group]


def ins_layout(options: InsEkfOptions) -> InsLayout:
    """Return the order of the error states of a filter.

    Args:
        options: Choices of the filter.

    Returns:
        Layout.
    """
    names = list(INS_ERROR_UNITS)[: options.states]
    if options.has_odometer_scale:
        names.append("odometer_scale")
    return InsLayout(tuple(names), options.states, options.has_odometer_scale)


def imu_errors(layout: InsLayout, sensor: Tensor) -> ImuErrors:
    """Return the sensor parameters of a belief taken apart.

    Args:
        layout: Order of the error states.
        sensor: Sensor parameters, shape (..., m).
    """
    return errors_of(sensor, layout.sensor_states)


def moved_state(state: InsState, correction: Tensor) -> InsState:
    """Return a state moved by a correction (minus the estimated error).

    Args:
        state: State, batch shape (...).
        correction: In the order of the error state, shape (..., 9) or longer.

    Returns:
        State.
    """
    lat, lon, height = shift_geodetic(
        state.lat, state.lon, state.height, *correction[..., :3].unbind(-1)
    )
    turn = quaternion_from_rotation_vector(correction[..., 6:9])
    q_lb = quaternion_multiply(turn, state.q_lb)
    q_lb = q_lb / q_lb.norm(dim=-1, keepdim=True)
    return InsState(lat, lon, height, state.v_l + correction[..., 3:6], q_lb)


def moved_belief(belief: InsBelief, correction: Tensor) -> InsBelief:
    """Return a belief moved by a correction; its covariance stays as it is.

    Args:
        belief: Belief, batch shape (...).
        correction: In the order of the error state, shape (..., n).

    Returns:
        Belief.
    """
    return belief._replace(
        state=moved_state(belief.state, correction), sensor=belief.sensor + correction[..., 9:]
    )


def state_difference(state: InsState, reference: InsState) -> Tensor:
    """Return position, velocity and attitude of a state minus another's, to first order.

    Inverse of :func:`moved_state`: with a truth as reference this is the error.

    Args:
        state: State, batch shape (...).
        reference: State nearby, batch shape (...).

    Returns:
        In the order of the error state: m, m/s, rad, shape (..., 9).
    """
    position = enu_between(*state[:3], *reference[:3])
    sign = state.q_lb.new_tensor([1.0, -1.0, -1.0, -1.0])
    turn = quaternion_multiply(state.q_lb, reference.q_lb * sign)
    # the shorter way round: q and −q are one attitude
    w, axis = turn[..., :1], turn[..., 1:]
    length = axis.norm(dim=-1, keepdim=True)
    small = length < 1e-8
    safe = torch.where(small, torch.ones_like(length), length)
    angle = 2.0 * torch.atan2(safe, w.abs()) * torch.where(w < 0.0, -1.0, 1.0)
    scale = torch.where(small, 2.0 * torch.where(w < 0.0, -1.0, 1.0), angle / safe)
    phi = scale * axis
    return torch.cat((torch.stack(position, -1), state.v_l - reference.v_l, phi), -1)


def belief_difference(belief: InsBelief, reference: InsBelief) -> Tensor:
    """Return a belief minus another nearby, in the order of the error state.

    Args:
        belief: Belief, batch shape (...).
        reference: Belief nearby, batch shape (...).

    Returns:
        Minus the correction that leads from ``belief`` to ``reference``, shape (..., n).
    """
    position = -torch.stack(shift_between(*reference.state[:3], *belief.state[:3]), -1)
    rest = state_difference(belief.state, reference.state)[..., 3:]
    return torch.cat((position, rest, belief.sensor - reference.sensor), -1)
