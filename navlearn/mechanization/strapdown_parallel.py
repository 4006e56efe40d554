"""Strapdown mechanization parallel in time, in the local level.

Attitude against inertial space is one prefix product over the record. Time is then cut into
chunks that fit the cache and in which gravity settles fast; within a chunk all samples go
together (:mod:`navlearn.mechanization.strapdown_chunk`), position and velocity are carried from
chunk to chunk.
"""

from typing import Literal

import torch
from torch import Tensor

from navlearn.mechanization.coning import check_channels, coning_sculling
from navlearn.mechanization.earth_fixed import unit
from navlearn.mechanization.increments import inertial_errors_removed
from navlearn.mechanization.meridian import level_to_meridian, place_in_meridian
from navlearn.mechanization.preintegration_turn import (
    Quaternion,
    prefix_products,
    product,
    quaternions_of,
)
from navlearn.mechanization.strapdown_chunk import Chunk, move_chunk
from navlearn.mechanization.strapdown_chunks import solve
from navlearn.mechanization.strapdown_shapes import check_start
from navlearn.states import ImuSample, InsState

Gradient = Literal["recompute", "tape"]


def strapdown_over_time(
    start: InsState,
    samples: ImuSample,
    *,
    gyro_bias: Tensor | None = None,
    accel_bias: Tensor | None = None,
    gyro_scale: Tensor | None = None,
    accel_scale: Tensor | None = None,
    gradient: Gradient = "recompute",
) -> InsState:
    """Return the solution over records, all samples at once.

    Equals :func:`navlearn.mechanization.strapdown.strapdown_in_turn`, and is differentiable in
    the start, the samples and the sensor errors.

    Args:
        start: State before the first interval, shape (...) each.
        samples: Samples, shape (..., T) each; intervals of dt = 0 move nothing. Speed and
            standstill are not looked at; float32 serves for increments, states stay float64.
        gyro_bias: Gyro bias, rad/s, shape (..., 3) or (..., T, 3); None means zero.
        accel_bias: Accelerometer bias, m/s², shape likewise; None means zero.
        gyro_scale: Relative error of the gyros, shape likewise; None means zero.
        accel_scale: Relative error of the accelerometers, shape likewise; None means zero.
        gradient: ``recompute`` differentiates in reverse, once, and keeps next to nothing;
            ``tape`` by autograd, any order and forward mode, in one chunk: for five minutes.

    Returns:
        States at the ends of intervals, shape (..., T) each.

    Raises:
        ShapeError: If the start does not have the samples' batch shape, or is not float64.
    """
    true = inertial_errors_removed(samples, gyro_bias, accel_bias, gyro_scale, accel_scale)
    rotation, velocity = coning_sculling(true.omega_ib_b, true.f_b, true.dt)
    return local_level_over_time(start, rotation, velocity, samples.dt, gradient)


def local_level_over_time(
    start: InsState,
    rotation: Tensor,
    velocity: Tensor,
    dt: Tensor,
    gradient: Gradient = "recompute",
) -> InsState:
    """Return the solution from compensated increments, all at once.

    Args:
        start: State before the first interval, shape (...) each.
        rotation: Rotation vectors, rad, shape (..., T, 3), as
            :func:`navlearn.mechanization.coning.coning_sculling` gives them.
        velocity: Velocity increments in the body at the start of each interval, m/s, likewise.
        dt: Length of the intervals, s, shape (..., T); zero, with zero increments, moves nothing.
        gradient: ``recompute`` differentiates in reverse, once, and keeps next to nothing;
            ``tape`` by autograd, any order and forward mode, in one chunk: for five minutes.

    Returns:
        States at the ends of intervals, shape (..., T) each.

    Raises:
        ShapeError: If shapes do not go together, or the start is not float64.
    """
    check_channels("local_level_over_time", rotation, velocity, dt)
    check_start("local_level_over_time", start, dt)
    # what accumulates must not be float32, which rounds positions to half a metre
    rotation, velocity, dt = (x.to(start.lat.dtype) for x in (rotation, velocity, dt))
    shape = dt.shape
    records, length = shape[:-1].numel(), shape[-1]
    flat = dt.reshape(records, length)
    turn, push = (x.movedim(-1, 0).reshape(3, records, length) for x in (rotation, velocity))
    r, v, q, lon = _in_meridian(start, records)
    a, b, c, d = (torch.cat(x, -1) for x in zip(q, quaternions_of(turn), strict=True))
    attitude = prefix_products((a, b, c, d))
    whole = Chunk(r, v, torch.cumsum(flat, -1), flat, turn, push, *attitude, lon)
    place, v_l, q_lb = solve(whole) if gradient == "recompute" else move_chunk(whole, False)[:3]
    lat, lon, height = (x.reshape(shape) for x in place.unbind(0))
    v_l, q_lb = (x.reshape(len(x), *shape).movedim(0, -1) for x in (v_l, q_lb))
    return InsState(lat, lon, height, v_l, q_lb)


def _in_meridian(start: InsState, records: int) -> tuple[Tensor, Tensor, Quaternion, Tensor]:
    """Return position, velocity and attitude in the meridian frame of the start, and longitude."""
    lat, lon, height = (x.reshape(records, 1) for x in start[:3])
    east, north, up = start.v_l.reshape(records, 1, 3).unbind(-1)
    sin_lat, cos_lat, zero = torch.sin(lat), torch.cos(lat), torch.zeros_like(lat)
    out, along = place_in_meridian(sin_lat, cos_lat, height)
    r = torch.stack((out, zero, along))
    v = torch.stack((cos_lat * up - sin_lat * north, east, cos_lat * north + sin_lat * up))
    level = level_to_meridian(sin_lat, cos_lat, torch.ones_like(lat), zero)
    w, x, y, z = unit(start.q_lb).reshape(records, 1, 4).unbind(-1)
    return r, v, product(level, (w, x, y, z)), lon
