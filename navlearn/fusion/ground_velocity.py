"""Velocity over ground by odometer and azimuth, and how errors move it."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.error_dynamics import per_tilt
from navlearn.fusion.sensor_errors import SensorErrors, corrected_motion, gyro_regressor
from navlearn.states import RissSample


class BlockEnd(NamedTuple):
    """The sample at whose end a block ends, shape (...) each.

    Attributes:
        sample: Last sample.
        acceleration: Forward acceleration by the odometer there, m/s².
    """

    sample: RissSample
    acceleration: Tensor


class TurnRate(NamedTuple):
    """Turn rate of the car at the end of a block.

    Attributes:
        rate: Ȧ against the Earth, Earth rate left out, rad/s, shape (...).
        by_error: Its change per error state, shape (..., n).
    """

    rate: Tensor
    by_error: Tensor


class GroundVelocity(NamedTuple):
    """Velocity and its change per error state.

    Attributes:
        velocity: East, north, up, m/s, shape (..., 3).
        by_error: Shape (..., 3, n).
    """

    velocity: Tensor
    by_error: Tensor


class Odometry(NamedTuple):
    """What the last sample says with sensor errors removed, for both functions below.

    Attributes:
        v_h: Horizontal velocity, m/s, shape (...).
        v_u: Velocity up, m/s, shape (...).
        turn: Turn rate and its derivative.
        by_sensor: Change of (v_h, v_u) per sensor parameter, shape (..., 2, m).
    """

    v_h: Tensor
    v_u: Tensor
    turn: TurnRate
    by_sensor: Tensor


def odometry(errors: SensorErrors, end: BlockEnd, sensor: Tensor) -> Odometry:
    """Return what the last sample says about velocity and turning.

    Args:
        errors: Sensor parameters of the filter.
        end: Last sample of a block.
        sensor: Sensor parameters, shape (..., m).

    Returns:
        Velocity, turn rate and their derivatives.
    """
    sample, zero = end.sample, torch.zeros_like(end.acceleration)
    motion = corrected_motion(
        errors, sample, end.acceleration, sensor, sensor, torch.ones_like(zero)
    )
    moving = torch.where(motion.dt > 0.0, 1.0, 0.0).to(zero)
    rate = motion.turn / torch.where(motion.dt > 0.0, motion.dt, torch.ones_like(zero))
    pitch = sample.pitch - sensor[..., -1] if errors.pitch_bias else sample.pitch
    tilt = per_tilt(errors, sample, pitch) * moving
    turns: list[Tensor] = []
    levels: list[Tensor] = []
    climbs: list[Tensor] = []
    if errors.velocity_states:
        turns, levels, climbs = [zero, tilt], [zero, zero], [zero, zero]
    scale = zero
    j = len(errors.gyro_terms)
    for term in errors.speed_terms:
        if term == "scale":
            scale = sensor[..., j]
        j += 1
    if not errors.velocity_states:
        for term in errors.gyro_terms:
            turns.append(tilt * gyro_regressor(term, sample))
            levels.append(zero)
            climbs.append(zero)
        for term in errors.speed_terms:
            turns.append(zero)
            if term == "scale":
                levels.append(-motion.v_h / (1.0 + scale))
                climbs.append(-motion.v_u / (1.0 + scale))
            else:
                push = end.acceleration * moving / (1.0 + scale)
                levels.append(push * torch.cos(pitch) if errors.three_d else push)
                climbs.append(push * torch.sin(pitch) if errors.three_d else zero)
        if errors.pitch_bias:
            tangent = torch.tan(pitch)
            turns.append(-rate * tangent if errors.tilt_compensation else zero)
            levels.append(tangent * motion.v_h)
            climbs.append(-motion.v_h)
    first = 7 if errors.velocity_states else 4
    by_error = torch.stack([zero] * first + turns, -1)
    if len(levels) == 0:
        by_sensor = sensor.unsqueeze(-2).expand(*sensor.shape[:-1], 2, 0)
    else:
        by_sensor = torch.stack((torch.stack(levels, -1), torch.stack(climbs, -1)), -2)
    return Odometry(motion.v_h, motion.v_u, TurnRate(rate, by_error), by_sensor)


def ground_velocity(
    errors: SensorErrors, told: Odometry, azimuth: Tensor, offset: Tensor, lag: Tensor
) -> GroundVelocity:
    """Return the velocity a moment before the end of a block.

    Args:
        errors: Sensor parameters of the filter.
        told: What the last sample says.
        azimuth: Azimuth at the end, rad, shape (...).
        offset: Velocity offset, m/s, shape (..., 3).
        lag: How long before the end, s, shape (...).

    Returns:
        Velocity and its change per error state; where velocity is a state it stands for itself.
    """
    earlier = azimuth - told.turn.rate * lag
    sine, cosine = torch.sin(earlier), torch.cos(earlier)
    v_e, v_n = told.v_h * sine, told.v_h * cosine
    velocity = torch.stack((v_e, v_n, told.v_u), -1) + offset
    zero = torch.zeros_like(v_e)
    across = torch.stack((v_n, -v_e, zero), -1).unsqueeze(-1)
    turned = -lag.unsqueeze(-1) * told.turn.by_error
    by_error = across * turned.unsqueeze(-2)
    if errors.velocity_states:
        unit = torch.eye(3, dtype=v_e.dtype, device=v_e.device)
        return GroundVelocity(velocity, by_error + torch.nn.functional.pad(unit, (3, 3)))
    level, climb = told.by_sensor.unbind(-2)
    direct = torch.stack((level * sine.unsqueeze(-1), level * cosine.unsqueeze(-1), climb), -2)
    columns = torch.cat((across, direct), -1)
    return GroundVelocity(velocity, by_error + torch.nn.functional.pad(columns, (3, 0)))
