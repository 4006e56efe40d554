"""Strapdown mechanization in the local level, sample by sample: streaming, scriptable, the oracle.

[Groves2013] §5.4 turned from NED to ENU, [Dahmane2022] Eq. (1). Within an interval the car moves
in the local level of its start, which is fixed to the Earth; then the level is carried along to
where the car has come, and velocity and attitude are resolved in the new one. So the transport
rate is exact and needs no term in the velocity equation. Latitudes within 0.1° of a pole are
outside the domain.
"""

import torch
from torch import Tensor

from navlearn import attitude, earth, wgs84
from navlearn.mechanization.coning import coning_sculling
from navlearn.mechanization.earth_fixed import moved_in_earth_fixed_frame, turned_back, unit
from navlearn.mechanization.increments import inertial_errors_removed
from navlearn.mechanization.local_level import geodetic_change, gravity_on_the_way
from navlearn.mechanization.strapdown_shapes import check_start
from navlearn.states import ImuSample, InsState


def local_level_step(state: InsState, rotation: Tensor, velocity: Tensor, dt: Tensor) -> InsState:
    """Return the state after one interval.

    Gravity is that of the middle of the interval, the Earth's and the level's turn are exact.

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
    lat, height = state.lat, state.height
    h = dt.unsqueeze(-1)
    gravity = gravity_on_the_way(lat, height, 0.5 * h * state.v_l)
    turn_of_earth = earth.earth_rate_enu(lat) * h
    q_lb = unit(state.q_lb)
    C_lb = attitude.matrix_from_quaternion(q_lb)
    v, way = moved_in_earth_fixed_frame(
        state.v_l, C_lb, rotation, velocity, gravity, turn_of_earth, h
    )
    moved = geodetic_change(lat, height, way)
    # seen from halfway, what the level turned is one rotation to third order
    middle = lat + 0.5 * moved.lat
    sin_lat, cos_lat = torch.sin(middle), torch.cos(middle)
    of_place = torch.stack((-moved.lat, cos_lat * moved.lon, sin_lat * moved.lon), dim=-1)
    grid = moved.lon + wgs84.EARTH_RATE * dt
    of_level = torch.stack((-moved.lat, cos_lat * grid, sin_lat * grid), dim=-1)
    q_lb = attitude.quaternion_multiply(
        attitude.quaternion_from_rotation_vector(-of_level),
        attitude.quaternion_multiply(q_lb, attitude.quaternion_from_rotation_vector(rotation)),
    )
    return InsState(
        lat + moved.lat,
        state.lon + moved.lon,
        height + moved.height,
        turned_back(v, of_place),
        q_lb,
    )


def local_level_in_turn(
    start: InsState, rotation: Tensor, velocity: Tensor, dt: Tensor
) -> InsState:
    """Return the states after all intervals, one step after another; scriptable.

    Args:
        start: State before the first interval, shape (...) each.
        rotation: Rotation vectors, rad, shape (..., T, 3); see :func:`local_level_step`.
        velocity: Velocity increments, m/s, shape (..., T, 3).
        dt: Length of the intervals, s, shape (..., T); T may be 0.

    Returns:
        States at the ends, shape (..., T) each, of the start's type.
    """
    dtype = start.lat.dtype
    rotation, velocity, dt = rotation.to(dtype), velocity.to(dtype), dt.to(dtype)
    state = start
    lat: list[Tensor] = []
    lon: list[Tensor] = []
    height: list[Tensor] = []
    v_l: list[Tensor] = []
    q_lb: list[Tensor] = []
    # unbind: indexing inside a loop would make the backward pass quadratic
    for turn, push, h in zip(rotation.unbind(-2), velocity.unbind(-2), dt.unbind(-1)):  # noqa: B905
        state = local_level_step(state, turn, push, h)
        lat.append(state.lat)
        lon.append(state.lon)
        height.append(state.height)
        v_l.append(state.v_l)
        q_lb.append(state.q_lb)
    if len(lat) == 0:
        return InsState(
            start.lat.unsqueeze(-1)[..., :0],
            start.lon.unsqueeze(-1)[..., :0],
            start.height.unsqueeze(-1)[..., :0],
            start.v_l.unsqueeze(-2)[..., :0, :],
            start.q_lb.unsqueeze(-2)[..., :0, :],
        )
    return InsState(
        torch.stack(lat, -1),
        torch.stack(lon, -1),
        torch.stack(height, -1),
        torch.stack(v_l, -2),
        torch.stack(q_lb, -2),
    )


def strapdown_in_turn(
    start: InsState,
    samples: ImuSample,
    *,
    gyro_bias: Tensor | None = None,
    accel_bias: Tensor | None = None,
    gyro_scale: Tensor | None = None,
    accel_scale: Tensor | None = None,
) -> InsState:
    """Return the solution over records, one sample after another: the oracle.

    Args:
        start: State before the first interval, shape (...) each.
        samples: Samples, shape (..., T) each; intervals of dt = 0 move nothing. Speed and
            standstill are not looked at; float32 serves for increments, states stay float64.
        gyro_bias: Gyro bias, rad/s, shape (..., 3) or (..., T, 3); None means zero.
        accel_bias: Accelerometer bias, m/s², shape likewise; None means zero.
        gyro_scale: Relative error of the gyros, shape likewise; None means zero.
        accel_scale: Relative error of the accelerometers, shape likewise; None means zero.

    Returns:
        States at the ends of intervals, shape (..., T) each.

    Raises:
        ShapeError: If the start does not have the samples' batch shape, or is not float64.
    """
    check_start("strapdown_in_turn", start, samples.dt)
    true = inertial_errors_removed(samples, gyro_bias, accel_bias, gyro_scale, accel_scale)
    rotation, velocity = coning_sculling(true.omega_ib_b, true.f_b, true.dt)
    return local_level_in_turn(start, rotation, velocity, samples.dt)
