"""Strapdown mechanization in the Earth-centred Earth-fixed frame, and the way there and back.

[Jaradat2017] Eqs. (5)–(11), [Groves2013] §5.3: v̇ = C_eb f + g − 2 ω_ie × v. The paper writes
gravitation and the centrifugal force as two terms; here g is plumb gravity, which holds both.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import attitude, wgs84
from navlearn.mechanization.coning import coning_sculling
from navlearn.mechanization.earth_fixed import moved_in_earth_fixed_frame, unit
from navlearn.mechanization.increments import inertial_errors_removed
from navlearn.mechanization.meridian import (
    gravity_at,
    level_to_meridian,
    place_in_meridian,
    plumb_line,
)
from navlearn.mechanization.strapdown_shapes import check_fields
from navlearn.states import ImuSample, InsState


class EcefState(NamedTuple):
    """Position, velocity and attitude in the Earth-centred Earth-fixed frame.

    Shape (...) for a state, (..., T) for a solution at the end of every interval.

    Attributes:
        position: Position, m, shape (..., 3).
        velocity: Velocity against the Earth, m/s, shape (..., 3).
        q_eb: Scalar-first unit quaternion that turns body into the Earth frame, shape (..., 4).
    """

    position: Tensor
    velocity: Tensor
    q_eb: Tensor


def ecef_step(state: EcefState, rotation: Tensor, velocity: Tensor, dt: Tensor) -> EcefState:
    """Return the state after one interval.

    Args:
        state: State at the start, shape (...) each.
        rotation: Rotation vector of the body against inertial space over the interval, coning
            compensated, rad, shape (..., 3).
        velocity: Velocity increment by specific force in the body at the start of the interval,
            sculling and turning compensated, m/s, shape (..., 3); see
            :func:`navlearn.mechanization.coning.coning_sculling`.
        dt: Length of the interval, s, shape (...); zero, with zero increments, moves nothing.

    Returns:
        State at the end.
    """
    h = dt.unsqueeze(-1)
    x, y, z = torch.unbind(state.position + 0.5 * h * state.velocity, -1)
    gravity = torch.stack(gravity_at(x, y, z), dim=-1)
    zero = torch.zeros_like(dt)
    turn_of_earth = torch.stack((zero, zero, wgs84.EARTH_RATE * dt), dim=-1)
    q_eb = unit(state.q_eb)
    C_eb = attitude.matrix_from_quaternion(q_eb)
    v, way = moved_in_earth_fixed_frame(
        state.velocity, C_eb, rotation, velocity, gravity, turn_of_earth, h
    )
    turned = attitude.quaternion_multiply(q_eb, attitude.quaternion_from_rotation_vector(rotation))
    q_eb = attitude.quaternion_multiply(
        attitude.quaternion_from_rotation_vector(-turn_of_earth), turned
    )
    return EcefState(state.position + way, v, q_eb)


def ecef_in_turn(start: EcefState, rotation: Tensor, velocity: Tensor, dt: Tensor) -> EcefState:
    """Return the states after all intervals, one step after another; scriptable.

    Args:
        start: State before the first interval, shape (...) each.
        rotation: Rotation vectors, rad, shape (..., T, 3); see :func:`ecef_step`.
        velocity: Velocity increments, m/s, shape (..., T, 3).
        dt: Length of the intervals, s, shape (..., T); T may be 0.

    Returns:
        States at the ends, shape (..., T) each, of the start's type.
    """
    dtype = start.position.dtype
    rotation, velocity, dt = rotation.to(dtype), velocity.to(dtype), dt.to(dtype)
    state = start
    r: list[Tensor] = []
    v: list[Tensor] = []
    q: list[Tensor] = []
    # unbind: indexing inside a loop would make the backward pass quadratic
    for turn, push, h in zip(rotation.unbind(-2), velocity.unbind(-2), dt.unbind(-1)):  # noqa: B905
        state = ecef_step(state, turn, push, h)
        r.append(state.position)
        v.append(state.velocity)
        q.append(state.q_eb)
    if len(r) == 0:
        return EcefState(
            start.position.unsqueeze(-2)[..., :0, :],
            start.velocity.unsqueeze(-2)[..., :0, :],
            start.q_eb.unsqueeze(-2)[..., :0, :],
        )
    return EcefState(torch.stack(r, -2), torch.stack(v, -2), torch.stack(q, -2))


def strapdown_ecef_in_turn(
    start: EcefState,
    samples: ImuSample,
    *,
    gyro_bias: Tensor | None = None,
    accel_bias: Tensor | None = None,
    gyro_scale: Tensor | None = None,
    accel_scale: Tensor | None = None,
) -> EcefState:
    """Return the solution over records, one sample after another.

    Args:
        start: State before the first interval, shape (...) each.
        samples: Samples, shape (..., T) each; intervals of dt = 0 move nothing;
            float32 serves for increments, states stay float64.
        gyro_bias: Gyro bias, rad/s, shape (..., 3) or (..., T, 3); None means zero.
        accel_bias: Accelerometer bias, m/s², shape likewise; None means zero.
        gyro_scale: Relative error of the gyros, shape likewise; None means zero.
        accel_scale: Relative error of the accelerometers, shape likewise; None means zero.

    Returns:
        States at the ends of intervals, shape (..., T) each.

    Raises:
        ShapeError: If the start does not have the samples' batch shape, or is not float64.
    """
    where, batch = "strapdown_ecef_in_turn", samples.dt.shape[:-1]
    expected = ((*batch, 3), (*batch, 3), (*batch, 4))
    check_fields(where, dict(zip(start._fields, start, strict=True)), expected, samples.dt)
    true = inertial_errors_removed(samples, gyro_bias, accel_bias, gyro_scale, accel_scale)
    rotation, velocity = coning_sculling(true.omega_ib_b, true.f_b, true.dt)
    return ecef_in_turn(start, rotation, velocity, samples.dt)


def to_ecef(state: InsState) -> EcefState:
    """Return a local-level state in the Earth-centred Earth-fixed frame.

    Args:
        state: State or solution, shape (...) each.

    Returns:
        The same state.
    """
    level = _level(torch.sin(state.lat), torch.cos(state.lat), state.lon)
    out, along = place_in_meridian(torch.sin(state.lat), torch.cos(state.lat), state.height)
    position = torch.stack((out * torch.cos(state.lon), out * torch.sin(state.lon), along), dim=-1)
    C_el = attitude.matrix_from_quaternion(level)
    v = (C_el @ state.v_l.unsqueeze(-1)).squeeze(-1)
    return EcefState(position, v, attitude.quaternion_multiply(level, state.q_lb))


def from_ecef(state: EcefState) -> InsState:
    """Return an Earth-centred Earth-fixed state in local level.

    Args:
        state: State or solution, shape (...) each; not within 0.1° of a pole.

    Returns:
        The same state, longitude in (−π, π].
    """
    x, y, z = torch.unbind(state.position, -1)
    line = plumb_line(x, y, z)
    lon = torch.atan2(y, x)
    level = _level(line.sin_lat, line.cos_lat, lon)
    C_el = attitude.matrix_from_quaternion(level)
    back = level * torch.tensor([1.0, -1.0, -1.0, -1.0], dtype=level.dtype, device=level.device)
    return InsState(
        torch.atan2(line.sin_lat, line.cos_lat),
        lon,
        line.height,
        (C_el.transpose(-1, -2) @ state.velocity.unsqueeze(-1)).squeeze(-1),
        attitude.quaternion_multiply(back, state.q_eb),
    )


def _level(sin_lat: Tensor, cos_lat: Tensor, lon: Tensor) -> Tensor:
    half = 0.5 * lon
    parts = level_to_meridian(sin_lat, cos_lat, torch.cos(half), torch.sin(half))
    return torch.stack(parts, dim=-1)
