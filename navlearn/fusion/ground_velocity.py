"""Velocity over ground by odometer and azimuth, and how errors move it.

A GNSS velocity is that of an instant, the odometer's the mean of an interval, whose middle lies
half an interval back: the speed is carried on to the instant by the odometer's acceleration.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.error_dynamics import per_tilt
from navlearn.fusion.sensor_errors import (
    SensorErrors,
    corrected_motion,
    gyro_regressor,
    speed_regressor,
)
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
        v_h: Horizontal velocity, mean of the interval, m/s, shape (...).
        v_u: Velocity up, mean of the interval, m/s, shape (...).
        push_h: Growth of v_h, m/s², shape (...).
        push_u: Growth of v_u, m/s², shape (...).
        half: Half the interval, s, shape (...).
        turn: Turn rate and its derivative.
        by_sensor: Change of (v_h, v_u) per sensor parameter, shape (..., 2, m).
        push_by_sensor: The same of (push_h, push_u), shape (..., 2, m).
    """

    v_h: Tensor
    v_u: Tensor
    push_h: Tensor
    push_u: Tensor
    half: Tensor
    turn: TurnRate
    by_sensor: Tensor
    push_by_sensor: Tensor


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
    scale = zero
    if "scale" in errors.speed_terms:
        scale = sensor[..., len(errors.gyro_terms) + errors.speed_terms.index("scale")]
    per_scale = 1.0 / (1.0 + scale)
    push = end.acceleration * moving * per_scale
    push_h = push * torch.cos(pitch) if errors.three_d else push
    push_u = push * torch.sin(pitch) if errors.three_d else zero
    turns: list[Tensor] = [zero, tilt] if errors.velocity_states else []
    changes: list[tuple[Tensor, ...]] = [(zero, zero, zero, zero)] * len(turns)
    if not errors.velocity_states:
        for term in errors.gyro_terms:
            turns.append(tilt * gyro_regressor(term, sample))
            changes.append((zero, zero, zero, zero))
        for term in errors.speed_terms:
            turns.append(zero)
            if term == "scale":
                ahead = (motion.v_h, motion.v_u, push_h, push_u)
                changes.append(tuple(-per_scale * x for x in ahead))
            else:
                added = speed_regressor(term, sample, end.acceleration) * moving * per_scale
                level = added * torch.cos(pitch) if errors.three_d else added
                climb = added * torch.sin(pitch) if errors.three_d else zero
                changes.append((level, climb, zero, zero))
        if errors.pitch_bias:
            tangent = torch.tan(pitch)
            turns.append(-rate * tangent if errors.tilt_compensation else zero)
            changes.append((tangent * motion.v_h, -motion.v_h, tangent * push_h, -push_h))
    first = 7 if errors.velocity_states else 4
    turn = TurnRate(rate, torch.stack([zero] * first + turns, -1))
    by_sensor = sensor.new_zeros((*sensor.shape[:-1], 4, 0))
    if changes:
        rows = [torch.stack(row, -1) for row in zip(*changes, strict=True)]
        by_sensor = torch.stack(rows, -2)
    half = 0.5 * sample.dt
    v, pushes = by_sensor[..., :2, :], by_sensor[..., 2:, :]
    return Odometry(motion.v_h, motion.v_u, push_h, push_u, half, turn, v, pushes)


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
    ahead = told.half - lag
    v_h, v_u = told.v_h + ahead * told.push_h, told.v_u + ahead * told.push_u
    v_e, v_n = v_h * sine, v_h * cosine
    velocity = torch.stack((v_e, v_n, v_u), -1) + offset
    zero = torch.zeros_like(v_e)
    across = torch.stack((v_n, -v_e, zero), -1).unsqueeze(-1)
    turned = -lag.unsqueeze(-1) * told.turn.by_error
    by_error = across * turned.unsqueeze(-2)
    if errors.velocity_states:
        # the velocity states are those of the interval's mean: azimuth turns the rest with it
        rest = (ahead * told.push_h).unsqueeze(-1)
        more = rest * torch.stack((cosine, -sine, zero), -1)
        unit = torch.eye(3, dtype=v_e.dtype, device=v_e.device).expand(*v_e.shape, 3, 3)
        columns = torch.nn.functional.pad(torch.cat((unit, more.unsqueeze(-1)), -1), (3, 2))
        return GroundVelocity(velocity, by_error + columns)
    along = told.by_sensor + ahead.unsqueeze(-1).unsqueeze(-1) * told.push_by_sensor
    level, climb = along.unbind(-2)
    direct = torch.stack((level * sine.unsqueeze(-1), level * cosine.unsqueeze(-1), climb), -2)
    columns = torch.cat((across, direct), -1)
    return GroundVelocity(velocity, by_error + torch.nn.functional.pad(columns, (3, 0)))
