"""What is measured at the end of a block: innovation, H and R, for every kind at once.

H is the derivative of the predicted measurement by the estimate (the error with its sign), so a
correction K ν is added. Sources: [Noureldin2013] §8.3 for position and velocity with a lever
arm; standstill as in `error models`: the mean gyro rate is Earth rate plus the gyro's errors.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.filters.belief import Belief
from navlearn.fusion.antenna import CarAtEnd, antenna_offset, antenna_velocity
from navlearn.fusion.error_state import position_difference
from navlearn.fusion.ground_velocity import BlockEnd, odometry
from navlearn.fusion.lever_arm import turned_arm
from navlearn.fusion.measured import Measured, MeasurementModel, Occasion
from navlearn.fusion.measurements import Kind
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.standstill import Rest
from navlearn.states import GnssFix, NavState


class _Part(NamedTuple):
    innovation: Tensor
    observation: Tensor
    variance: Tensor
    present: Tensor


def measured(
    model: MeasurementModel, belief: Belief, occasion: Occasion, noise: EkfNoise
) -> Measured:
    """Return innovation, H and R of all that is measured at the end of blocks.

    Args:
        model: What the filter measures.
        belief: Prediction at the end of each block, shape (...).
        occasion: What there is to measure, shape (...).
        noise: Deviations of measurements.

    Returns:
        Innovations of all kinds.
    """
    zero = torch.zeros_like(belief.state.lat)
    present = [zero] * len(Kind)
    possible = [bool(_possible(model, occasion, kind).any()) for kind in model.rows.kinds]
    car = car_at_end(model, belief, occasion.end) if any(possible) else None
    # a filter that takes nothing has rows, too: none
    none = zero.new_zeros((*zero.shape, 0))
    innovations, variances = [none], [none]
    observations = [zero.new_zeros((*zero.shape, 0, model.layout.size))]
    for kind, rows, here in zip(model.rows.kinds, model.rows.count, possible, strict=True):
        if car is None or not here:
            innovations.append(zero.unsqueeze(-1).expand(*zero.shape, rows))
            variances.append(torch.ones_like(innovations[-1]))
            observations.append(zero[..., None, None].expand(*zero.shape, rows, model.layout.size))
            continue
        part = _BUILD[kind](_Scene(model, occasion, car, noise))
        there = (part.present > 0.5).unsqueeze(-1)
        innovations.append(torch.where(there, part.innovation, 0.0))
        variances.append(torch.where(there, part.variance, 1.0))
        observations.append(torch.where(there.unsqueeze(-1), part.observation, 0.0))
        present[kind] = part.present
    return Measured(
        torch.cat(innovations, -1),
        torch.cat(observations, -2),
        torch.cat(variances, -1),
        torch.stack(present, -1),
        astray=occasion.astray,
    )


def _possible(model: MeasurementModel, occasion: Occasion, kind: IntEnum) -> Tensor:
    if kind == Kind.POSITION:
        return occasion.fix.has_position > 0.5
    if kind in (Kind.VELOCITY, Kind.COURSE):
        return occasion.fix.has_velocity > 0.5
    return _stands(model, occasion.rest)


def _stands(model: MeasurementModel, rest: Rest) -> Tensor:
    # a microsecond of slack: ten tenths of a second do not sum to one
    return (rest.standing >= model.standstill - 1e-6) & (rest.duration > 0.0)


class _Scene(NamedTuple):
    """All that a measurement may depend on."""

    model: MeasurementModel
    occasion: Occasion
    car: CarAtEnd
    noise: EkfNoise


def car_at_end(model: MeasurementModel, belief: Belief, end: BlockEnd) -> CarAtEnd:
    """Return the car at the end of blocks as fixes and ranges see it.

    Args:
        model: What the filter measures.
        belief: Belief at the end, batch shape (...).
        end: Last sample of each block, shape (...) each.
    """
    told, arm = odometry(model.errors, end, belief.sensor), None
    if model.lever_arm is not None:
        arm = turned_arm(model.errors, model.lever_arm, belief, end.sample)
    return CarAtEnd(model.errors, model.layout, belief, told, arm)


def _position(scene: _Scene) -> _Part:
    _, occasion, car, noise = scene
    fix, state = occasion.fix, car.belief.state
    at = NavState(fix.lat, fix.lon, fix.height, state.azimuth)
    there = antenna_offset(car, occasion.delay)
    innovation = position_difference(at, state) - there.value
    sigma = torch.stack((fix.std_e, fix.std_n, fix.std_u), -1) * noise.position_inflation
    floor = torch.stack((noise.position_floor, noise.position_floor, noise.height_floor))
    return _Part(innovation, there.by_error, sigma * sigma + floor * floor, fix.has_position)


def _velocity(scene: _Scene) -> _Part:
    model, occasion, car, noise = scene
    fix = occasion.fix
    now = antenna_velocity(car, occasion.delay)
    rows = model.rows.of(Kind.VELOCITY)
    count = 3 if rows is None else rows.stop - rows.start
    innovation = torch.stack((fix.v_e, fix.v_n, fix.v_u), -1) - now.value
    variance = _velocity_variance(fix, noise).unsqueeze(-1).expand(innovation.shape)
    return _Part(
        innovation[..., :count],
        now.by_error[..., :count, :],
        variance[..., :count],
        fix.has_velocity,
    )


def _velocity_variance(fix: GnssFix, noise: EkfNoise) -> Tensor:
    sigma = fix.std_v * noise.velocity_inflation
    return sigma * sigma + noise.velocity_floor**2 + noise.speed_noise**2


def _course(scene: _Scene) -> _Part:
    model, occasion, car, noise = scene
    fix, azimuth, told = occasion.fix, car.belief.state.azimuth, car.told
    slow = model.course_speed
    speed = torch.sqrt(fix.v_e * fix.v_e + fix.v_n * fix.v_n)
    fast = (speed > slow) & (told.v_h > slow) & (fix.has_velocity > 0.5)
    safe = torch.where(fast, speed, torch.ones_like(speed))
    course = torch.atan2(fix.v_e, torch.where(fast, fix.v_n, torch.ones_like(speed)))
    innovation = wrap_angle(course - azimuth + told.turn.rate * occasion.delay)
    unit = torch.zeros_like(told.turn.by_error)
    unit[..., model.layout.azimuth] = 1.0
    observation = unit - occasion.delay.unsqueeze(-1) * told.turn.by_error
    sigma = fix.std_v * noise.velocity_inflation
    variance = (sigma * sigma + noise.velocity_floor**2) / (safe * safe)
    return _Part(
        innovation.unsqueeze(-1), observation.unsqueeze(-2), variance.unsqueeze(-1), fast.to(speed)
    )


def _zero_yaw_rate(scene: _Scene) -> _Part:
    model, occasion, car, noise = scene
    rest, belief, n = occasion.rest, car.belief, model.layout.size
    still = _stands(model, rest).to(rest.duration)
    first = model.layout.first_sensor
    if model.errors.velocity_states:
        first += 1
    count = rest.regressors.shape[-1]
    at = first - model.layout.first_sensor
    parameters = belief.sensor[..., at : at + count]
    known = (rest.regressors * parameters).sum(-1)
    earth = model.earth_rate * torch.sin(belief.state.lat)
    innovation = rest.yaw_rate - known - earth
    observation = torch.nn.functional.pad(rest.regressors, (first, n - first - count))
    length = rest.duration.clamp(min=1e-3)
    # the deviation is that of a second's mean; shorter ones must not count for as much
    variance = noise.zero_yaw_rate**2 / length.clamp(max=1.0) + noise.gyro_random_walk**2 / length
    return _Part(innovation.unsqueeze(-1), observation.unsqueeze(-2), variance.unsqueeze(-1), still)


def _zero_speed(scene: _Scene) -> _Part:
    model, occasion, car, noise = scene
    still = _stands(model, occasion.rest).to(occasion.delay)
    now = car.moving(torch.zeros_like(occasion.delay))
    variance = (noise.zero_speed**2).expand(now.velocity.shape)
    return _Part(-now.velocity, now.by_error, variance, still)


_BUILD: dict[IntEnum, Callable[[_Scene], _Part]] = {
    Kind.POSITION: _position,
    Kind.VELOCITY: _velocity,
    Kind.COURSE: _course,
    Kind.ZERO_YAW_RATE: _zero_yaw_rate,
    Kind.ZERO_SPEED: _zero_speed,
}
