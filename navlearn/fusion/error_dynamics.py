"""Continuous error dynamics ẋ = F x + w of one sample, for every model.

Error is estimate minus reference. ``bias_scale``: velocity is no state, its error is that of
azimuth, odometer and pitch. Shen models, [Shen2010] Eqs. (6)–(8) with the slips repaired that
would hide a sign: δȦ = +δω (estimated minus true bias turns the azimuth clockwise), δv_e moves
δλ. As printed (``shen2010``) v̇ keeps only the accelerating part of a turning velocity;
``shen2010_full`` has the V·Ȧ and V·δω terms too.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.noise import EkfNoise, azimuth_density, height_density, walk_densities
from navlearn.fusion.sensor_errors import SensorErrors, decaying, gyro_regressor, speed_regressor
from navlearn.mechanization.motion import RissMotion
from navlearn.states import RissSample


def per_tilt(errors: SensorErrors, samples: RissSample, pitch: Tensor) -> Tensor:
    """Return how much the azimuth turns per yaw rate, 1/(cos p cos r) or ones.

    Args:
        errors: Sensor parameters of the filter.
        samples: Samples, shape (...) each.
        pitch: Corrected pitch, rad, shape (...).

    Returns:
        Ratio, shape (...).
    """
    if not errors.tilt_compensation:
        return torch.ones_like(samples.dt)
    return 1.0 / (torch.cos(pitch) * torch.cos(samples.roll))


def bias_scale_dynamics(
    errors: SensorErrors,
    samples: RissSample,
    acceleration: Tensor,
    motion: RissMotion,
    azimuth: Tensor,
    sensor: Tensor,
) -> Tensor:
    """Return F of the ``bias_scale`` states at one sample.

    Args:
        errors: Sensor parameters of the filter.
        samples: Samples, shape (...) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (...).
        motion: Motion of the samples, errors removed.
        azimuth: Azimuth at the middle of the interval, rad, shape (...).
        sensor: Sensor parameters, shape (..., m).

    Returns:
        F, 1/s, shape (..., n, n).
    """
    zero = torch.zeros_like(azimuth)
    sine, cosine = torch.sin(azimuth), torch.cos(azimuth)
    v_e, v_n = motion.v_h * sine, motion.v_h * cosine
    pitch = samples.pitch - sensor[..., -1] if errors.pitch_bias else samples.pitch
    moving = torch.where(motion.dt > 0.0, 1.0, 0.0).to(zero)
    tilt = per_tilt(errors, samples, pitch) * moving
    columns: list[Tensor] = [torch.stack((v_n, -v_e, zero, zero), -1)]
    for term in errors.gyro_terms:
        turn = tilt * gyro_regressor(term, samples)
        columns.append(torch.stack((zero, zero, zero, turn), -1))
    scale = zero
    j = len(errors.gyro_terms)
    for term in errors.speed_terms:
        if term == "scale":
            scale = sensor[..., j]
        j += 1
    for term in errors.speed_terms:
        if term == "scale":
            column = -torch.stack((v_e, v_n, motion.v_u, zero), -1)
        else:
            level, climb = speed_regressor(term, samples, acceleration) * moving, zero
            if errors.three_d:
                climb = level * torch.sin(pitch)
                level = level * torch.cos(pitch)
            column = torch.stack((level * sine, level * cosine, climb, zero), -1)
        columns.append(column / (1.0 + scale).unsqueeze(-1))
    if errors.pitch_bias:
        tangent = torch.tan(pitch)
        rate = motion.turn / torch.where(motion.dt > 0.0, motion.dt, torch.ones_like(zero))
        turn = -rate * tangent if errors.tilt_compensation else zero
        columns.append(torch.stack((tangent * v_e, tangent * v_n, -motion.v_h, turn), -1))
    top = torch.stack(columns, -1)
    m = len(columns) - 1
    return torch.nn.functional.pad(top, (3, 0, 0, m)) + returning(errors, zero, 4)


class ShenTerms(NamedTuple):
    """What drives the Shen states at a sample, shape (...) each.

    Attributes:
        by_e: Growth of δv_e per azimuth error, m/s².
        by_n: Growth of δv_n per azimuth error, m/s².
        east: Direction of travel, east.
        north: Direction of travel, north.
        up: Direction of travel, up.
        side_e: Growth of δv_e per gyro bias error, m/s.
        side_n: Growth of δv_n per gyro bias error, m/s.
        turn: Growth of δA per gyro bias error.
        duration: Growth of δposition per velocity error: 1 for rates, dt for increments.
    """

    by_e: Tensor
    by_n: Tensor
    east: Tensor
    north: Tensor
    up: Tensor
    side_e: Tensor
    side_n: Tensor
    turn: Tensor
    duration: Tensor


def shen_terms(
    errors: SensorErrors,
    samples: RissSample,
    acceleration: Tensor,
    motion: RissMotion,
    sine: Tensor,
    cosine: Tensor,
    full: bool,
) -> ShenTerms:
    """Return the entries of F of the Shen states at samples.

    [Shen2010] Eqs. (6)–(9).

    Args:
        errors: Sensor parameters of the filter.
        samples: Samples, shape (...) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (...).
        motion: Motion of the samples, errors removed.
        sine: Sine of the azimuth at the middle of the interval, shape (...).
        cosine: Cosine of the same, shape (...).
        full: Whether the terms of a turning velocity are there.

    Returns:
        Entries of F.
    """
    zero, one = torch.zeros_like(sine), torch.ones_like(sine)
    pitch = samples.pitch if errors.three_d else zero
    moving = torch.where(motion.dt > 0.0, 1.0, 0.0).to(zero)
    level, climb = torch.cos(pitch) * moving, torch.sin(pitch) * moving
    gain = acceleration * level
    by_e, by_n = gain * cosine, -gain * sine
    turn = per_tilt(errors, samples, pitch) * moving
    side_e, side_n = zero, zero
    if full:
        rate = motion.turn / torch.where(motion.dt > 0.0, motion.dt, one)
        by_e = by_e - motion.v_h * sine * rate
        by_n = by_n - motion.v_h * cosine * rate
        side_e, side_n = motion.v_h * cosine * turn, -motion.v_h * sine * turn
    return ShenTerms(by_e, by_n, sine * level, cosine * level, climb, side_e, side_n, turn, moving)


def shen_dynamics(terms: ShenTerms) -> Tensor:
    """Return F of the Shen states, or its integral when the entries are integrals.

    Args:
        terms: Entries.

    Returns:
        F, shape (..., 9, 9); the decay of sensor parameters is left to the caller.
    """
    zero, t = torch.zeros_like(terms.turn), terms.duration
    # (3 positions, 3 velocities, azimuth) driven by (3 velocities, azimuth, a_od, ω_z)
    rows = [
        *(t, zero, zero, zero, zero, zero),
        *(zero, t, zero, zero, zero, zero),
        *(zero, zero, t, zero, zero, zero),
        *(zero, zero, zero, terms.by_e, -terms.east, terms.side_e),
        *(zero, zero, zero, terms.by_n, -terms.north, terms.side_n),
        *(zero, zero, zero, zero, -terms.up, zero),
        *(zero, zero, zero, zero, zero, terms.turn),
    ]
    return torch.nn.functional.pad(torch.stack(rows, -1).reshape(*zero.shape, 7, 6), (3, 0, 0, 2))


def returning(errors: SensorErrors, zero: Tensor, first: int) -> Tensor:
    """Return the part of F by which Gauss–Markov parameters return.

    Args:
        errors: Sensor parameters of the filter.
        zero: Zeros of the batch shape.
        first: Index of the first sensor parameter.

    Returns:
        Diagonal matrix, 1/s, shape (..., n, n).
    """
    flags = decaying(errors)
    rate = 0.0 if errors.correlation_time == 0.0 else -1.0 / errors.correlation_time
    entries = [zero for _ in range(first)] + [zero + rate if flag else zero for flag in flags]
    return torch.diag_embed(torch.stack(entries, -1))


def diffusion(
    errors: SensorErrors, samples: RissSample, motion: RissMotion, noise: EkfNoise
) -> Tensor:
    """Return the spectral density of the noise at one sample.

    Args:
        errors: Sensor parameters of the filter.
        samples: Samples, shape (...) each.
        motion: Motion of the samples; where its dt is zero the car is held and only sensor
            parameters walk.
        noise: Noise densities.

    Returns:
        Qc, shape (..., n, n).
    """
    zero = torch.zeros_like(samples.dt)
    moving = torch.where(motion.dt > 0.0, 1.0, 0.0).to(zero)
    walk = noise.position_walk**2 * moving
    entries = [walk, walk, height_density(errors, noise) * moving]
    if errors.velocity_states:
        velocity = noise.velocity_walk**2 * moving
        entries += [velocity, velocity, velocity]
    entries.append(azimuth_density(samples, noise) * moving)
    for density in walk_densities(errors, noise):
        entries.append(zero if density is None else zero + density**2)
    return torch.diag_embed(torch.stack(entries, -1))
