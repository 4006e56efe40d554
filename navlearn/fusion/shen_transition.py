"""Transition and process noise of a block for the Shen states, composed of ten sub-steps.

Velocity states feed on azimuth and azimuth on gyro bias, with factors that change along the
block: a product of ten second-order steps, all blocks at once.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.block_motion import BlockMotion
from navlearn.fusion.error_dynamics import ShenTerms, shen_dynamics, shen_terms
from navlearn.fusion.noise import EkfNoise, azimuth_density, height_density
from navlearn.fusion.sensor_errors import SensorErrors, decay_over
from navlearn.fusion.transition import Linearised
from navlearn.states import RissSample

SUB_STEPS = 10


class OffsetMotion(NamedTuple):
    """What the velocity offset does in a block.

    Attributes:
        way: Extra way, east, north, up, m, shape (..., n, 3) at the end of each sample.
        velocity: Mean velocity offset in each interval, m/s, shape (..., n, 3).
        offset: Velocity offset at the end, m/s, shape (..., 3).
    """

    way: Tensor
    velocity: Tensor
    offset: Tensor


def move_offset(
    errors: SensorErrors, moved: BlockMotion, samples: RissSample, sensor: Tensor, offset: Tensor
) -> OffsetMotion:
    """Return the extra way by a velocity offset that an acceleration bias wears away.

    Args:
        errors: Sensor parameters of the filter.
        moved: The blocks as mechanized.
        samples: Their samples, shape (..., n) each.
        sensor: Sensor parameters, shape (..., 2).
        offset: Velocity offset at the start, m/s, shape (..., 3).

    Returns:
        Extra way and the offset at the end.
    """
    dt = moved.motion.dt
    gain = -sensor[..., :1] * moved.decay * dt
    level = torch.cos(samples.pitch) if errors.three_d else torch.ones_like(dt)
    climb = torch.sin(samples.pitch) if errors.three_d else torch.zeros_like(dt)
    change = torch.stack((gain * moved.sine * level, gain * moved.cosine * level, gain * climb), -1)
    later = offset.unsqueeze(-2) + torch.cumsum(change, -2)
    mean = later - 0.5 * change
    return OffsetMotion(torch.cumsum(mean * dt.unsqueeze(-1), -2), mean, later[..., -1, :])


def shen_transition(
    errors: SensorErrors,
    moved: BlockMotion,
    samples: RissSample,
    acceleration: Tensor,
    noise: EkfNoise,
    full: bool,
) -> Linearised:
    """Return transition and process noise of blocks.

    Args:
        errors: Sensor parameters of the filter.
        moved: The blocks as mechanized.
        samples: Their samples, shape (..., n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (..., n).
        noise: Noise densities.
        full: Whether the terms of a turning velocity are there.

    Returns:
        Φ and Q, shape (..., 9, 9) each.
    """
    motion = moved.motion
    terms = shen_terms(errors, samples, acceleration, motion, moved.sine, moved.cosine, full)
    sums = ShenTerms(*(_grouped(entry * motion.dt) for entry in terms))
    q_azimuth = _grouped(azimuth_density(samples, noise) * motion.dt)
    duration, moving = _grouped(samples.dt), _grouped(motion.dt)
    zero = torch.zeros_like(duration)
    walk, climb = noise.position_walk**2 * moving, height_density(errors, noise) * moving
    velocity = noise.velocity_walk**2 * moving
    sensors = [noise.acceleration_walk**2 * duration, noise.gyro_bias_walk**2 * duration]
    q = torch.diag_embed(torch.stack([walk, walk, climb, *[velocity] * 3, q_azimuth, *sensors], -1))
    growth = shen_dynamics(sums)
    if errors.correlation_time > 0.0:
        rate = torch.log(decay_over(errors, duration))
        growth = growth + torch.diag_embed(torch.stack([*[zero] * 7, rate, rate], -1))
    eye = torch.eye(9, dtype=growth.dtype, device=growth.device)
    steps = eye + growth + 0.5 * growth @ growth
    transition, noise_sum = eye.expand_as(steps[..., 0, :, :]), torch.zeros_like(q[..., 0, :, :])
    for step, half in zip(steps.unbind(-3), (0.5 * q).unbind(-3), strict=True):
        transition = step @ transition
        noise_sum = step @ (noise_sum + half) @ step.transpose(-1, -2) + half
    return Linearised(transition, noise_sum)


def _grouped(channel: Tensor) -> Tensor:
    size = -(-channel.shape[-1] // SUB_STEPS)
    padded = torch.nn.functional.pad(channel, (0, SUB_STEPS * size - channel.shape[-1]))
    return padded.reshape(*channel.shape[:-1], SUB_STEPS, size).sum(-1)
