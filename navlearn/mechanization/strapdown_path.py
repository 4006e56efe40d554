"""Where known forces and gravity lead: positions and velocities of one chunk, all at once.

Everything is resolved in the meridian frame of the record's start. Turned once more by the
Earth's angle since then, velocity is a sum of what forces add (that second turn is what takes the
Coriolis force away), and position is a sum of velocities. Only gravity depends on where the car
comes to. A path that falls as at the chunk's start is corrected on a few nodes
(:mod:`navlearn.mechanization.gravity_correction`), gravity is taken along it at every sample, and
what that leaves is corrected on the nodes once more. What comes out is what
:func:`navlearn.mechanization.earth_fixed.moved_in_earth_fixed_frame` gives in turn, to rounding.
Arrays lie as (records, samples), or (3, records, samples) for vectors.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.mechanization.gravity_correction import (
    bend,
    nodes_of,
    picked,
    sloping,
    spread,
    spread_rate,
)
from navlearn.mechanization.meridian import gravity_at

TOLERANCE = 1e-11
"""Error of position up to which a chunk needs no corrections, m."""

GRADIENT = 3.1e-6
"""How fast gravity grows upward, 1/s²: in no direction does it change faster."""

STEP = 1000.0
"""Way over which the gradient of gravity is taken, m: as good as infinitely short."""


class Pushed(NamedTuple):
    """What is known of a chunk before gravity.

    Attributes:
        total: Velocity at the chunk's start and what forces have added to it by the end of each
            interval, turned by twice the Earth's angle, m/s, shape (3, B, n).
        lag: What the bending of forces within intervals adds to the way, m, shape (3, B, n).
        dt: Length of the intervals, s, shape (B, n).
        at_middle: Cosine and sine of twice the Earth's angle at the middles, shape (B, n) each.
        at_end: The same at the ends.
    """

    total: Tensor
    lag: Tensor
    dt: Tensor
    at_middle: tuple[Tensor, Tensor]
    at_end: tuple[Tensor, Tensor]


def path(r_0: Tensor, v_0: Tensor, pushed: Pushed, adaptive: bool) -> tuple[Tensor, Tensor]:
    """Return the way from a chunk's start and the velocity, at the ends of intervals.

    Args:
        r_0: Position at the chunk's start, m, shape (3, B, 1).
        v_0: Velocity at the chunk's start, m/s, shape (3, B, 1).
        pushed: What is known.
        adaptive: Whether a chunk that is short enough goes without corrections.

    Returns:
        Way (m) and velocity (m/s), shape (3, B, n) each.
    """
    level, slope = _gravity_near(r_0)
    way, v, middle = _sums(v_0, level, pushed)
    if adaptive and _short(middle, pushed.dt):
        way, v, _ = _sums(v_0, _gravity(r_0 + middle), pushed)
        return way, v
    nodes, count = nodes_of(pushed.dt), pushed.dt.shape[-1]
    there = picked(middle, nodes.stride)
    guess = bend(sloping(torch.zeros_like(level), slope, there), slope, nodes.step, 4)
    moved = picked(spread(guess, nodes.at_middle, count), nodes.stride)
    push = sloping(_gravity(r_0 + there + moved) - level, slope, -moved)
    guess = bend(push, slope, nodes.step, 4)
    middle = middle + spread(guess, nodes.at_middle, count)
    way, v, moved = _sums(v_0, _gravity(r_0 + middle), pushed)
    missed = picked(moved - middle, nodes.stride)
    last = bend(sloping(torch.zeros_like(level), slope, missed), slope, nodes.step, 2)
    return way + spread(last, nodes.at_end, count), v + spread_rate(last, nodes.at_end, count)


def _sums(v_0: Tensor, gravity: Tensor, pushed: Pushed) -> tuple[Tensor, Tensor, Tensor]:
    """Return ways and velocities at the ends, and ways at the middles, for a known gravity."""
    dt = pushed.dt
    fall = turned(gravity, *pushed.at_middle) * dt
    v = turned_back(torch.cumsum(fall, -1) + pushed.total, *pushed.at_end)
    before = _before(v_0, v)
    way = torch.cumsum(torch.addcmul(pushed.lag, 0.5 * dt, before + v), -1)
    middle = torch.addcmul(_before(torch.zeros_like(v_0), way), 0.5 * dt, before)
    return way, v, middle


def _gravity_near(r: Tensor) -> tuple[Tensor, Tensor]:
    """Return gravity at a place, (3, B, 1), and its derivative along each axis, (3, 3, B, 1)."""
    unit = STEP * torch.eye(3, dtype=r.dtype, device=r.device).unsqueeze(1)
    gravity = _gravity(torch.cat((r, r + unit, r - unit), -1))
    slope = (gravity[..., 1:4] - gravity[..., 4:7]) / (2.0 * STEP)
    return gravity[..., :1], slope.movedim(-1, 0).unsqueeze(-1)


def _gravity(r: Tensor) -> Tensor:
    return torch.stack(gravity_at(r[0], r[1], r[2]))


def _short(middle: Tensor, dt: Tensor) -> bool:
    """Return whether gravity on the path that falls as at its start is exact enough."""
    reach = float(middle.detach().abs().amax()) if middle.numel() else 0.0
    square = GRADIENT * float(dt.detach().sum(-1).amax()) ** 2
    return reach * square / 6.0 * square / 20.0 <= TOLERANCE


def _before(start: Tensor, ends: Tensor) -> Tensor:
    return torch.cat((start, ends[..., :-1]), -1)


def turned(vector: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Return vectors turned about the z axis.

    Args:
        vector: Vectors, shape (3, ...).
        cos: Cosine of the angle, shape (...).
        sin: Sine of the angle, shape (...).

    Returns:
        Turned vectors, shape (3, ...).
    """
    x, y, z = vector.unbind(0)
    across = x * cos - y * sin
    return torch.stack((across, torch.addcmul(x * sin, y, cos), z.expand_as(across)))


def turned_back(vector: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Return vectors turned about the z axis the other way; see :func:`turned`."""
    return turned(vector, cos, -sin)
