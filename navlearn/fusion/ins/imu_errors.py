"""The sensor parameters of a full-IMU filter as vectors, and what the sensors tell without them."""

from typing import NamedTuple

import torch
from torch import Tensor


class SensorStates(NamedTuple):
    """Which sensor errors are states.

    Attributes:
        bias: Gyro and accelerometer biases.
        scale: Gyro and accelerometer scale factors; only together with biases.
        odometer_scale: The odometer's scale, in the last place.
    """

    bias: bool
    scale: bool
    odometer_scale: bool


class ImuErrors(NamedTuple):
    """The sensor parameters of a belief as vectors, neutral where they are no states.

    Attributes:
        gyro_bias: rad/s, shape (..., 3).
        accel_bias: m/s², shape (..., 3).
        gyro_gain: 1 + scale error, shape (..., 3).
        accel_gain: 1 + scale error, shape (..., 3).
        odometer_gain: 1 + scale error, shape (...).
    """

    gyro_bias: Tensor
    accel_bias: Tensor
    gyro_gain: Tensor
    accel_gain: Tensor
    odometer_gain: Tensor


def errors_of(sensor: Tensor, has: SensorStates) -> ImuErrors:
    """Return sensor parameters taken apart; scriptable.

    Args:
        sensor: Sensor parameters, shape (..., m).
        has: Which sensor errors are states.
    """
    one = sensor.new_ones(sensor.shape[:-1])
    gyro_bias = torch.zeros_like(one).unsqueeze(-1).repeat_interleave(3, -1)
    accel_bias = gyro_bias
    gyro_gain, accel_gain, odometer_gain = 1.0 + gyro_bias, 1.0 + gyro_bias, one
    if has.bias:
        gyro_bias, accel_bias = sensor[..., 0:3], sensor[..., 3:6]
    if has.scale:
        gyro_gain, accel_gain = 1.0 + sensor[..., 6:9], 1.0 + sensor[..., 9:12]
    if has.odometer_scale:
        odometer_gain = 1.0 + sensor[..., -1]
    return ImuErrors(gyro_bias, accel_bias, gyro_gain, accel_gain, odometer_gain)


def imu_corrected(errors: ImuErrors, omega_ib_b: Tensor, f_b: Tensor) -> tuple[Tensor, Tensor]:
    """Return angular rate and specific force without the sensors' errors; scriptable.

    Args:
        errors: Sensor parameters.
        omega_ib_b: Measured angular rate, rad/s, shape (..., 3).
        f_b: Measured specific force, m/s², shape (..., 3).
    """
    omega = (omega_ib_b - errors.gyro_bias) / errors.gyro_gain
    return omega, (f_b - errors.accel_bias) / errors.accel_gain
