"""Noise densities and deviations as tensors, so that they can be learned through the filter."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.sensor_errors import SensorErrors
from navlearn.states import RissSample


class EkfNoise(NamedTuple):
    """The entries of :class:`navlearn.fusion.options.NoiseOptions`, one tensor of shape () each.

    Meaning and units are told there.
    """

    gyro_random_walk: Tensor
    turn_noise: Tensor
    gyro_bias_walk: Tensor
    speed_scale_walk: Tensor
    pitch_bias_walk: Tensor
    position_walk: Tensor
    height_walk: Tensor
    hill_walk: Tensor
    velocity_walk: Tensor
    acceleration_walk: Tensor
    position_floor: Tensor
    height_floor: Tensor
    position_inflation: Tensor
    velocity_floor: Tensor
    velocity_inflation: Tensor
    speed_noise: Tensor
    zero_yaw_rate: Tensor
    zero_speed: Tensor


def log_noise(options: NoiseOptions) -> Tensor:
    """Return the logarithms of all noise entries, what an optimiser moves.

    Args:
        options: Noise densities and deviations.

    Returns:
        Logarithms in the order of :class:`EkfNoise`, −inf for zero, shape (18,).
    """
    values = [getattr(options, name) for name in EkfNoise._fields]
    return torch.log(torch.tensor(values, dtype=torch.float64))


def noise_from_log(log: Tensor) -> EkfNoise:
    """Return the noise entries of their logarithms.

    Args:
        log: As :func:`log_noise` returns, shape (18,).

    Returns:
        Noise entries.
    """
    return EkfNoise(*torch.exp(log).unbind(-1))


def height_density(errors: SensorErrors, noise: EkfNoise) -> Tensor:
    """Return the spectral density of what moves a driving car upwards of the model, m²/s.

    Args:
        errors: Tells whether the mechanization climbs.
        noise: Noise densities.
    """
    return noise.height_walk**2 if errors.three_d else noise.hill_walk**2


def azimuth_density(samples: RissSample, noise: EkfNoise) -> Tensor:
    """Return the spectral density of azimuth noise, more in turns.

    Args:
        samples: Samples, shape (...) each.
        noise: Noise densities.

    Returns:
        Density, rad²/s, shape (...).
    """
    turning = noise.turn_noise * samples.yaw_rate
    return noise.gyro_random_walk**2 + turning * turning


def walk_densities(errors: SensorErrors, noise: EkfNoise) -> list[Tensor | None]:
    """Return the random-walk density of each sensor parameter; None where it has none.

    Args:
        errors: Sensor parameters of the filter.
        noise: Noise densities.

    Returns:
        One entry per sensor parameter, its unit per √s.
    """
    if errors.velocity_states:
        return [noise.acceleration_walk, noise.gyro_bias_walk]
    walks: list[Tensor | None] = []
    for term in errors.gyro_terms:
        walks.append(noise.gyro_bias_walk if term == "bias" else None)
    for term in errors.speed_terms:
        walks.append(noise.speed_scale_walk if term == "scale" else None)
    if errors.pitch_bias:
        walks.append(noise.pitch_bias_walk)
    return walks
