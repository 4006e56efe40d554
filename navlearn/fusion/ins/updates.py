"""What a full-IMU filter measures at the end of a block: innovation, H and R, all kinds at once.

H is the derivative of the predicted measurement by the estimate (the error with its sign), so a
correction K ν is added. Sources: [Groves2013] §14.3.1 (position and velocity with a lever arm),
§15.1 (odometer, axle), §15.3 (zero velocity and zero angular rate), turned to ENU and RFU.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth
from navlearn.filters.ins_belief import InsBelief
from navlearn.frames import enu_between
from navlearn.fusion.ins.antenna import ins_antenna_offset, ins_antenna_velocity
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.moment import Moment, columns, moment_of, skew_of
from navlearn.fusion.ins.noise import InsNoise
from navlearn.fusion.ins.timeline import InsOccasion, InsRest
from navlearn.fusion.ins.wheels import axle_velocity
from navlearn.fusion.measured import Measured
from navlearn.states import GnssFix


class _Part(NamedTuple):
    innovation: Tensor
    observation: Tensor
    variance: Tensor
    present: Tensor


class _Scene(NamedTuple):
    """All that a measurement may depend on."""

    model: InsFilterModel
    belief: InsBelief
    occasion: InsOccasion
    now: Moment
    noise: InsNoise


def ins_measured(
    model: InsFilterModel, belief: InsBelief, occasion: InsOccasion, noise: InsNoise
) -> Measured:
    """Return innovation, H and R of all that is measured at the end of blocks.

    Args:
        model: The filter.
        belief: Prediction at the end of each block, batch shape (...).
        occasion: What there is to measure, batch shape (...).
        noise: Deviations of measurements.

    Returns:
        Innovations of all kinds.
    """
    scene = _Scene(model, belief, occasion, moment_of(model, belief, occasion.last), noise)
    zero = torch.zeros_like(belief.state.lat)
    present = [zero] * len(InsKind)
    # a filter that takes nothing has rows, too: none
    none = zero.new_zeros((*zero.shape, 0))
    innovations, variances = [none], [none]
    observations = [zero.new_zeros((*zero.shape, 0, model.layout.size))]
    for kind, rows in zip(model.rows.kinds, model.rows.count, strict=True):
        there = _present(model, occasion, kind)
        if not bool((there > 0.5).any()):
            innovations.append(zero.unsqueeze(-1).expand(*zero.shape, rows))
            variances.append(torch.ones_like(innovations[-1]))
            observations.append(zero[..., None, None].expand(*zero.shape, rows, model.layout.size))
            continue
        part = _BUILD[kind](scene)
        there = there * part.present
        keep = (there > 0.5).unsqueeze(-1)
        innovations.append(torch.where(keep, part.innovation[..., :rows], 0.0))
        variances.append(torch.where(keep, part.variance[..., :rows], 1.0))
        observations.append(torch.where(keep.unsqueeze(-1), part.observation[..., :rows, :], 0.0))
        present[kind] = there
    return Measured(
        torch.cat(innovations, -1),
        torch.cat(observations, -2),
        torch.cat(variances, -1),
        torch.stack(present, -1),
        astray=occasion.astray,
    )


def _present(model: InsFilterModel, occasion: InsOccasion, kind: IntEnum) -> Tensor:
    if kind == InsKind.POSITION:
        return occasion.fix.has_position
    if kind == InsKind.VELOCITY:
        return occasion.fix.has_velocity
    still = stands(model, occasion.rest).to(occasion.delay)
    if kind == InsKind.ODOMETER:
        return occasion.aided * occasion.last.has_speed
    if kind == InsKind.NONHOLONOMIC:
        return occasion.aided
    return still


def stands(model: InsFilterModel, rest: InsRest) -> Tensor:
    """Return whether the car has stood long enough at the end of blocks.

    Args:
        model: The filter.
        rest: Standstill, batch shape (...).
    """
    # a microsecond of slack: ten tenths of a second do not sum to one
    return (rest.standing >= model.options.standstill - 1e-6) & (rest.duration > 0.0)


def _position(scene: _Scene) -> _Part:
    model, belief, occasion, now, noise = scene
    fix = occasion.fix
    there = ins_antenna_offset(model, belief, now, occasion.delay)
    between = enu_between(fix.lat, fix.lon, fix.height, *belief.state[:3])
    innovation = torch.stack(between, -1) - there.value
    sigma = torch.stack((fix.std_e, fix.std_n, fix.std_u), -1) * noise.position_inflation
    floor = torch.stack((noise.position_floor, noise.position_floor, noise.height_floor))
    variance = sigma * sigma + floor * floor
    return _Part(innovation, there.by_error, variance, torch.ones_like(occasion.delay))


def _velocity(scene: _Scene) -> _Part:
    model, belief, occasion, now, noise = scene
    fix = occasion.fix
    moving = ins_antenna_velocity(model, belief, now, occasion.delay)
    innovation = torch.stack((fix.v_e, fix.v_n, fix.v_u), -1) - moving.value
    variance = _velocity_variance(fix, noise)
    return _Part(innovation, moving.by_error, variance, torch.ones_like(occasion.delay))


def _velocity_variance(fix: GnssFix, noise: InsNoise) -> Tensor:
    sigma = fix.std_v * noise.velocity_inflation
    variance = sigma * sigma + noise.velocity_floor**2
    return variance.unsqueeze(-1).expand(*variance.shape, 3)


def _odometer(scene: _Scene) -> _Part:
    model, belief, occasion, now, noise = scene
    axle = axle_velocity(model, belief, now, 0.5 * occasion.last.dt)
    gain = now.errors.odometer_gain.unsqueeze(-1)
    ahead = axle.velocity[..., 1:2]
    observation = gain.unsqueeze(-1) * axle.by_error[..., 1:2, :]
    if model.layout.odometer_scale:
        n = model.layout.size
        observation = observation + torch.nn.functional.pad(ahead.unsqueeze(-1), (n - 1, 0))
    speed = occasion.last.speed.unsqueeze(-1)
    variance = (noise.odometer_noise**2).expand(ahead.shape)
    fast = (speed[..., 0].abs() >= model.options.least_speed).to(speed)
    return _Part(speed - gain * ahead, observation, variance, fast)


def _nonholonomic(scene: _Scene) -> _Part:
    model, belief, occasion, now, noise = scene
    axle = axle_velocity(model, belief, now, torch.zeros_like(occasion.delay))
    pick = axle.velocity[..., 0::2]
    variance = (noise.nonholonomic_noise**2).expand(pick.shape)
    fast = (axle.velocity[..., 1].detach().abs() >= model.options.least_speed).to(pick)
    return _Part(-pick, axle.by_error[..., 0::2, :], variance, fast)


def _zero_velocity(scene: _Scene) -> _Part:
    model, belief, occasion, now, noise = scene
    velocity = belief.state.v_l
    eye = torch.eye(3, dtype=velocity.dtype, device=velocity.device)
    H = columns(model.layout, now, velocity=eye.expand(*velocity.shape[:-1], 3, 3))
    length = occasion.rest.duration.clamp(min=1e-3, max=1.0).unsqueeze(-1)
    variance = (noise.zero_velocity**2 / length).expand(velocity.shape)
    return _Part(-velocity, H, variance, torch.ones_like(occasion.delay))


def _zero_angular_rate(scene: _Scene) -> _Part:
    model, belief, occasion, now, noise = scene
    rest = occasion.rest
    of_earth = earth.earth_rate_enu(belief.state.lat)
    turned = now.C_lb.transpose(-1, -2)
    sensed = (turned @ of_earth.unsqueeze(-1)).squeeze(-1)
    gain, bias = now.errors.gyro_gain, now.errors.gyro_bias
    eye = torch.eye(3, dtype=sensed.dtype, device=sensed.device).expand(*sensed.shape, 3)
    H = columns(
        model.layout,
        now,
        attitude=gain.unsqueeze(-1) * (turned @ skew_of(of_earth)),
        gyro_bias=eye,
        gyro_scale=torch.diag_embed(sensed),
    )
    length = rest.duration.clamp(min=1e-3).unsqueeze(-1)
    # the deviation is that of a second's mean; shorter ones must not count for as much
    variance = noise.zero_angular_rate**2 / length.clamp(max=1.0)
    variance = (variance + noise.gyro_random_walk**2 / length).expand(sensed.shape)
    innovation = rest.omega_ib_b - gain * sensed - bias
    return _Part(innovation, H, variance, torch.ones_like(occasion.delay))


_BUILD: dict[IntEnum, Callable[[_Scene], _Part]] = {
    InsKind.POSITION: _position,
    InsKind.VELOCITY: _velocity,
    InsKind.ODOMETER: _odometer,
    InsKind.NONHOLONOMIC: _nonholonomic,
    InsKind.ZERO_VELOCITY: _zero_velocity,
    InsKind.ZERO_YAW_RATE: _zero_angular_rate,
}
