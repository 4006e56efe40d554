"""Strapdown mechanization parallel in time, in the local level.

Time is cut into chunks that fit the cache and in which gravity settles in two or three passes;
within a chunk all samples go together (:mod:`navlearn.mechanization.strapdown_chunk`), the state
is carried from chunk to chunk.
"""

import torch
from torch import Tensor

from navlearn.mechanization.coning import check_channels, coning_sculling
from navlearn.mechanization.increments import inertial_errors_removed
from navlearn.mechanization.strapdown_chunk import Channels, move_chunk
from navlearn.mechanization.strapdown_shapes import check_start
from navlearn.states import ImuSample, InsState

CHUNK_ELEMENTS = 8192
"""Samples of all records together in one chunk."""


def strapdown_over_time(
    start: InsState,
    samples: ImuSample,
    *,
    gyro_bias: Tensor | None = None,
    accel_bias: Tensor | None = None,
    gyro_scale: Tensor | None = None,
    accel_scale: Tensor | None = None,
) -> InsState:
    """Return the solution over records, all samples at once.

    Equals :func:`navlearn.mechanization.strapdown.strapdown_in_turn`, and is differentiable in
    the start, the samples and the sensor errors.

    Args:
        start: State before the first interval, shape (...) each.
        samples: Samples, shape (..., T) each; intervals of dt = 0 move nothing. Speed and
            standstill are not looked at.
        gyro_bias: Gyro bias, rad/s, shape (..., 3) or (..., T, 3); None means zero.
        accel_bias: Accelerometer bias, m/s², shape likewise; None means zero.
        gyro_scale: Relative error of the gyros, shape likewise; None means zero.
        accel_scale: Relative error of the accelerometers, shape likewise; None means zero.

    Returns:
        States at the ends of intervals, shape (..., T) each.

    Raises:
        ShapeError: If the start does not have the samples' batch shape, or is not float64.
    """
    true = inertial_errors_removed(samples, gyro_bias, accel_bias, gyro_scale, accel_scale)
    rotation, velocity = coning_sculling(true.omega_ib_b, true.f_b, true.dt)
    return local_level_over_time(start, rotation, velocity, samples.dt)


def local_level_over_time(
    start: InsState, rotation: Tensor, velocity: Tensor, dt: Tensor
) -> InsState:
    """Return the solution from compensated increments, all at once.

    Args:
        start: State before the first interval, shape (...) each.
        rotation: Rotation vectors, rad, shape (..., T, 3), as
            :func:`navlearn.mechanization.coning.coning_sculling` gives them.
        velocity: Velocity increments in the body at the start of each interval, m/s, likewise.
        dt: Length of the intervals, s, shape (..., T); zero, with zero increments, moves nothing.

    Returns:
        States at the ends of intervals, shape (..., T) each.

    Raises:
        ShapeError: If shapes do not go together, or the start is not float64.
    """
    check_channels("local_level_over_time", rotation, velocity, dt)
    check_start("local_level_over_time", start, dt)
    shape = dt.shape
    records, length = shape[:-1].numel(), shape[-1]
    flat = dt.reshape(records, length)
    turn, push = (x.movedim(-1, 0).reshape(3, records, length) for x in (rotation, velocity))
    scalars = [x.reshape(records, 1) for x in start[:3]]
    axes = [x.unsqueeze(-1) for vector in start[3:] for x in vector.reshape(records, -1).unbind(-1)]
    state = Channels(*scalars, *axes)
    size = max(CHUNK_ELEMENTS // max(records, 1), 64)
    done = []
    for k in range(0, length, size):
        part = slice(k, min(k + size, length))
        ends = move_chunk(state, turn[..., part], push[..., part], flat[:, part], 12, True)
        done.append(ends)
        state = Channels(*(x[:, -1:] for x in ends))
    whole = [torch.cat(x, -1).reshape(shape) for x in zip(*done, strict=True)]
    return InsState(
        whole[0], whole[1], whole[2], torch.stack(whole[3:6], -1), torch.stack(whole[6:], -1)
    )
