"""Noise densities and deviations of the full-IMU filter as tensors, to be learned through it."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.ins.layout import InsLayout
from navlearn.fusion.ins.options import InsNoiseOptions


class InsNoise(NamedTuple):
    """The entries of :class:`navlearn.fusion.ins.options.InsNoiseOptions`, shape () each.

    Meaning and units are told there.
    """

    gyro_random_walk: Tensor
    accel_random_walk: Tensor
    turn_noise: Tensor
    gyro_bias_walk: Tensor
    accel_bias_walk: Tensor
    gyro_scale_walk: Tensor
    accel_scale_walk: Tensor
    odometer_scale_walk: Tensor
    position_floor: Tensor
    height_floor: Tensor
    position_inflation: Tensor
    velocity_floor: Tensor
    velocity_inflation: Tensor
    odometer_noise: Tensor
    nonholonomic_noise: Tensor
    zero_velocity: Tensor
    zero_angular_rate: Tensor


def log_ins_noise(options: InsNoiseOptions) -> Tensor:
    """Return the logarithms of all noise entries, what an optimiser moves.

    Args:
        options: Noise densities and deviations.

    Returns:
        Logarithms in the order of :class:`InsNoise`, −inf for zero, shape (17,).
    """
    values = [getattr(options, name) for name in InsNoise._fields]
    return torch.log(torch.tensor(values, dtype=torch.float64))


def ins_noise_from_log(log: Tensor) -> InsNoise:
    """Return the noise entries of their logarithms.

    Args:
        log: As :func:`log_ins_noise` returns, shape (17,).

    Returns:
        Noise entries.
    """
    return InsNoise(*torch.exp(log).unbind(-1))


def walks(layout: InsLayout, noise: InsNoise) -> Tensor:
    """Return the random walk of each sensor parameter, its unit per √s, shape (m,).

    Args:
        layout: Order of the error states.
        noise: Noise densities.
    """
    chosen: list[Tensor] = []
    if layout.has_bias:
        chosen += [noise.gyro_bias_walk] * 3 + [noise.accel_bias_walk] * 3
    if layout.has_scale:
        chosen += [noise.gyro_scale_walk] * 3 + [noise.accel_scale_walk] * 3
    if layout.odometer_scale:
        chosen.append(noise.odometer_scale_walk)
    return torch.stack(chosen) if chosen else noise.gyro_bias_walk.new_zeros(0)


def white_noise(noise: InsNoise) -> Tensor:
    """Return angle random walk, velocity random walk and turn noise, shape (3,)."""
    return torch.stack((noise.gyro_random_walk, noise.accel_random_walk, noise.turn_noise))
