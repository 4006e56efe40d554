"""What the car did in each interval, from one gyro, the odometer and tilt, errors removed.

Shared by the sequential and the parallel mechanization, so that both integrate the same motion.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.states import RissSample


class RissMotion(NamedTuple):
    """Motion over intervals, shape (...) or (..., T) each.

    Attributes:
        dt: Length of the interval, s; zero where nothing may move.
        turn: Change of azimuth against inertial space, rad, clockwise.
        v_h: Mean horizontal velocity along the mid-interval azimuth, m/s.
        v_u: Mean velocity up, m/s.
    """

    dt: Tensor
    turn: Tensor
    v_h: Tensor
    v_u: Tensor


def chord_over_arc(turn: Tensor) -> Tensor:
    """Return how much shorter the chord is than an arc of constant curvature.

    sin(x)/x of x = turn/2 by its series: smooth at zero, no sine, exact to 3e-6 for a half turn
    within one interval and to 1e-12 for half a radian.

    Args:
        turn: Angle turned along the arc, rad, shape (...).

    Returns:
        Ratio, shape (...).
    """
    u = 0.25 * turn * turn
    return 1.0 - u / 6.0 * (1.0 - u / 20.0 * (1.0 - u / 42.0 * (1.0 - u / 72.0)))


def riss_motion(
    sample: RissSample,
    gyro_bias: Tensor,
    odometer_scale: Tensor,
    pitch_bias: Tensor,
    three_d: bool = True,
    tilt_compensation: bool = True,
    hold_stationary: bool = False,
) -> RissMotion:
    """Return the motion that samples tell once the sensors' errors are removed.

    The gyro measures the true rate plus ``gyro_bias``, the odometer (1 + ``odometer_scale``)
    times the true speed, tilt the true pitch plus ``pitch_bias``. Turn from [Iqbal2020] §V with
    the tilt term of a turn on a slope; velocity from [Shen2010] Eq. (2). Speed acts along the
    chord of the arc that the gyro tells (the Earth's part in it shortens the chord by 2e-10 in
    intervals of a second, by 2e-14 at 100 Hz).

    Args:
        sample: Samples, shape (...) or (..., T) each.
        gyro_bias: Error of the yaw rate, rad/s, broadcastable to a channel.
        odometer_scale: Relative error of the odometer, broadcastable to a channel.
        pitch_bias: Error of the pitch, rad, broadcastable to a channel; unused in 2D.
        three_d: Whether pitch and roll are used.
        tilt_compensation: Whether the yaw rate is divided by cos p cos r (3D only).
        hold_stationary: Whether nothing moves where ``stationary`` is 1.

    Returns:
        Motion, shape of the samples.
    """
    dt = sample.dt
    speed = sample.speed / (1.0 + odometer_scale)
    if hold_stationary:
        moving = 1.0 - sample.stationary
        dt = dt * moving
        speed = speed * moving
    turn = (gyro_bias - sample.yaw_rate) * dt
    if not three_d:
        v_h = speed * chord_over_arc(turn)
        return RissMotion(dt, turn, v_h, torch.zeros_like(speed))
    pitch = sample.pitch - pitch_bias
    cos_pitch = torch.cos(pitch)
    if tilt_compensation:
        turn = turn / (cos_pitch * torch.cos(sample.roll))
    v_h = speed * cos_pitch * chord_over_arc(turn)
    return RissMotion(dt, turn, v_h, speed * torch.sin(pitch))


def over_time(value: Tensor, channel: Tensor) -> Tensor:
    """Return a sensor error that broadcasts over a channel's time.

    Args:
        value: One value per record, shape (...), or per sample, shape (..., T).
        channel: Any channel of the record, shape (..., T).

    Returns:
        Shape (..., 1) or (..., T).
    """
    return value.unsqueeze(-1) if value.dim() < channel.dim() else value
