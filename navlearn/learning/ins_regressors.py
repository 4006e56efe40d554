"""Regressors of a coasting full-IMU navigator that do not tell where in the world it is.

They are means over steps of about a second, in the body frame or about the local vertical, made
of the coast itself and of inertial readings less the errors that the filter knows: all of it is
there in an outage, and none of it depends on fixes after its start.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn import attitude
from navlearn.errors import ConfigError
from navlearn.states import InsState

INS_CHANNELS: Final[dict[str, str]] = {
    "forward_speed": "m/s",
    "lateral_speed": "m/s",
    "vertical_speed": "m/s",
    "forward_acceleration": "m/s²",
    "lateral_acceleration": "m/s²",
    "vertical_acceleration": "m/s²",
    "pitch_rate": "rad/s",
    "roll_rate": "rad/s",
    "yaw_rate": "rad/s",
    "abs_yaw_rate": "rad/s",
    "turned_angle": "rad",
    "pitch": "rad",
    "roll": "rad",
    "delay": "60 s",
    "turned_speed": "m/s",
    "delayed_speed": "m/s",
}
"""Channels by unit; specific forces are less gravity as the coast's attitude has it.

``turned_speed`` is forward speed times the angle turned since the start (how fast a gyro's scale
error carries the car aside), ``delayed_speed`` forward speed times the delay in units of 60 s
(the same of a gyro bias that the filter did not find).
"""

GRAVITY: Final = 9.80665
DELAY_SCALE: Final = 60.0
"""s; the delay since the last fix is divided by it, to be of the order of one."""


class CoastMeans(NamedTuple):
    """Means over steps of a coast, shape (..., S) and (..., S, 3).

    Attributes:
        dt: Length of the step, s.
        velocity_b: Velocity at the end of the step, body frame, m/s.
        omega_b: Angular rate of the body less known biases, rad/s.
        force_b: Specific force less known biases and less the reaction to gravity, m/s².
        pitch: Pitch at the end of the step, rad.
        roll: Roll at the end of the step, rad.
    """

    dt: Tensor
    velocity_b: Tensor
    omega_b: Tensor
    force_b: Tensor
    pitch: Tensor
    roll: Tensor


def coast_means(
    coast: InsState, dt: Tensor, omega_b: Tensor, f_b: Tensor, block: int
) -> CoastMeans:
    """Return means over steps of whole blocks of samples.

    Args:
        coast: The navigator without fixes, at the end of every sample, shape (..., L).
        dt: Length of the samples, s, shape (..., L).
        omega_b: Angular rates less known errors, rad/s, shape (..., L, 3).
        f_b: Specific forces less known errors, m/s², shape (..., L, 3).
        block: Samples per step; L is a multiple of it.

    Raises:
        ConfigError: L is no multiple of the block.
    """
    length = dt.shape[-1]
    if block < 1 or length % block:
        raise ConfigError(f"coast_means: {length} samples are no whole steps of {block}")
    c_lb = attitude.matrix_from_quaternion(coast.q_lb)
    up = c_lb[..., 2, :]
    steps = torch.unflatten(dt, -1, (length // block, block))
    share = (steps / steps.sum(-1, keepdim=True).clamp(min=1e-9)).unsqueeze(-1)

    def means(channel: Tensor) -> Tensor:
        return (share * torch.unflatten(channel, -2, (length // block, block))).sum(-2)

    at = slice(block - 1, None, block)
    turned = c_lb[..., at, :, :].transpose(-1, -2)
    _, pitch, roll = attitude.angles_from_matrix(c_lb[..., at, :, :])
    return CoastMeans(
        dt=steps.sum(-1),
        velocity_b=torch.matmul(turned, coast.v_l[..., at, :].unsqueeze(-1)).squeeze(-1),
        omega_b=means(omega_b),
        force_b=means(f_b - GRAVITY * up),
        pitch=pitch,
        roll=roll,
    )


def ins_regressors(means: CoastMeans, names: tuple[str, ...]) -> Tensor:
    """Return the named channels, counted from the start of the coast, shape (..., S, m).

    Args:
        means: Means over its steps.
        names: Any of :data:`INS_CHANNELS`, in the order wanted.

    Raises:
        ConfigError: A name is unknown, or there is none.
    """
    unknown = [name for name in names if name not in INS_CHANNELS]
    if unknown or not names:
        raise ConfigError(
            f"regressors: {', '.join(unknown) or 'none named'}; choose from "
            f"{', '.join(INS_CHANNELS)}"
        )
    lateral, forward, vertical = (means.velocity_b[..., k] for k in range(3))
    yaw_rate = means.omega_b[..., 2]
    turned = (yaw_rate * means.dt).cumsum(-1)
    delay = means.dt.cumsum(-1) / DELAY_SCALE
    channels = {
        "forward_speed": forward,
        "lateral_speed": lateral,
        "vertical_speed": vertical,
        "forward_acceleration": means.force_b[..., 1],
        "lateral_acceleration": means.force_b[..., 0],
        "vertical_acceleration": means.force_b[..., 2],
        "pitch_rate": means.omega_b[..., 0],
        "roll_rate": means.omega_b[..., 1],
        "yaw_rate": yaw_rate,
        "abs_yaw_rate": yaw_rate.abs(),
        "turned_angle": turned,
        "pitch": means.pitch,
        "roll": means.roll,
        "delay": delay,
        "turned_speed": forward * turned,
        "delayed_speed": forward * delay,
    }
    return torch.stack([channels[name] for name in names], -1)
