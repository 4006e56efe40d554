"""Mathematics of one chunk of the parallel strapdown, all its samples at once.

The chunk is resolved in the frame of :mod:`navlearn.mechanization.meridian` with x in the
meridian of its start, and in the inertial frame that coincides with it there. Against inertial
space the body's attitude is a product of known rotations; turned once more by the Earth's angle,
the velocity is a sum (that second turn is what takes the Coriolis force away); the position is a
sum of velocities. Only gravity depends on the path: it is solved by Picard iteration. What comes
out is what :func:`navlearn.mechanization.strapdown.local_level_step` gives in turn, to rounding.
Arrays lie as (records, samples), one per axis.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.mechanization.meridian import Plumb, Vector, plumb_gravity, plumb_line
from navlearn.mechanization.preintegration_turn import (
    Quaternion,
    prefix_products,
    product,
    quaternions_of,
)

TOLERANCE = 1e-9
"""Error of position at which a chunk's iteration may stop, m."""

GRADIENT = 3.1e-6
"""How fast gravity grows upward, 1/s²: no direction changes it faster."""


class Channels(NamedTuple):
    """A state, (records, 1) each, or a solution, (records, samples) each."""

    lat: Tensor
    lon: Tensor
    height: Tensor
    v_e: Tensor
    v_n: Tensor
    v_u: Tensor
    q_w: Tensor
    q_x: Tensor
    q_y: Tensor
    q_z: Tensor


class _Turn(NamedTuple):
    """Cosine and sine of an angle about the Earth's axis."""

    cos: Tensor
    sin: Tensor

    def doubled(self) -> "_Turn":
        return _Turn(self.cos * self.cos - self.sin * self.sin, 2.0 * self.cos * self.sin)


def _turned(vector: Vector, by: _Turn) -> Vector:
    x, y, z = vector
    return x * by.cos - y * by.sin, x * by.sin + y * by.cos, z


def _turned_back(vector: Vector, by: _Turn) -> Vector:
    x, y, z = vector
    return x * by.cos + y * by.sin, y * by.cos - x * by.sin, z


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _rotated(q: Quaternion, v: Vector) -> Vector:
    """Return q v q*: v + 2 w (q × v) + 2 q × (q × v)."""
    w, x, y, z = q
    axis = (x, y, z)
    once = _cross(axis, v)
    once = (once[0] + once[0], once[1] + once[1], once[2] + once[2])
    twice = _cross(axis, once)
    return (
        torch.addcmul(v[0] + twice[0], w, once[0]),
        torch.addcmul(v[1] + twice[1], w, once[1]),
        torch.addcmul(v[2] + twice[2], w, once[2]),
    )


def _before(start: Tensor, ends: Tensor) -> Tensor:
    return torch.cat((start.expand(*ends.shape[:-1], 1), ends[..., :-1]), -1)


def move_chunk(
    start: Channels, turn: Tensor, push: Tensor, dt: Tensor, passes: int, adaptive: bool
) -> Channels:
    """Return the states at the ends of a chunk's intervals.

    Args:
        start: State at the chunk's start, shape (B, 1) each.
        turn: Rotation vectors, rad, shape (3, B, n).
        push: Velocity increments in the body at the start of each interval, m/s, (3, B, n).
        dt: Length of the intervals, s, shape (B, n).
        passes: Passes over gravity, at most.
        adaptive: Whether to stop once the path has converged.

    Returns:
        Solution, shape (B, n) each.
    """
    sin_lat, cos_lat = torch.sin(start.lat), torch.cos(start.lat)
    r_0 = _place(sin_lat, cos_lat, start.height)
    v_0 = (
        cos_lat * start.v_u - sin_lat * start.v_n,
        start.v_e,
        cos_lat * start.v_n + sin_lat * start.v_u,
    )
    q_lb = (start.q_w, start.q_x, start.q_y, start.q_z)
    one, zero = torch.ones_like(sin_lat), torch.zeros_like(sin_lat)
    q_0 = product(_to_meridian(sin_lat, cos_lat, _Turn(one, zero)), q_lb)
    q_ib = product(q_0, prefix_products(quaternions_of(turn)))
    time = torch.cumsum(dt, -1)
    q_before = (
        _before(q_0[0], q_ib[0]),
        _before(q_0[1], q_ib[1]),
        _before(q_0[2], q_ib[2]),
        _before(q_0[3], q_ib[3]),
    )
    angle = wgs84.EARTH_RATE * (time - 0.5 * dt)
    at_middle = _Turn(torch.cos(angle), torch.sin(angle))
    u = (push[0], push[1], push[2])
    pushed = _turned(_rotated(q_before, u), at_middle)
    bent = _turned_back(_rotated(q_before, _cross((turn[0], turn[1], turn[2]), u)), at_middle)
    half_angle = 0.5 * wgs84.EARTH_RATE * time
    half_turn = _Turn(torch.cos(half_angle), torch.sin(half_angle))
    r, v = _path(r_0, v_0, pushed, bent, dt, at_middle, half_turn, (passes, adaptive))
    return _resolved(start.lon, r, v, q_ib, half_turn)


def _place(sin_lat: Tensor, cos_lat: Tensor, height: Tensor) -> Vector:
    e2 = wgs84.ECCENTRICITY_SQUARED
    r_n = wgs84.SEMI_MAJOR_AXIS * torch.rsqrt(1.0 - e2 * sin_lat * sin_lat)
    return (
        (r_n + height) * cos_lat,
        torch.zeros_like(height),
        ((1.0 - e2) * r_n + height) * sin_lat,
    )


def _to_meridian(sin_lat: Tensor, cos_lat: Tensor, half: _Turn) -> Quaternion:
    """Return the quaternion from local level to a meridian frame that lies west by an angle."""
    # q_z(angle + π/2) q_x(π/2 − lat), by half angles without another sine
    up = torch.sqrt(0.5 + 0.5 * sin_lat)
    out = 0.5 * cos_lat / up
    root = math.sqrt(0.5)
    cos, sin = root * (half.cos - half.sin), root * (half.cos + half.sin)
    return cos * up, cos * out, sin * out, sin * up


def _path(
    r_0: Vector,
    v_0: Vector,
    pushed: Vector,
    bent: Vector,
    dt: Tensor,
    at_middle: _Turn,
    half_turn: _Turn,
    how: tuple[int, bool],
) -> tuple[Vector, Vector]:
    """Return positions and velocities at the ends of intervals."""
    passes, adaptive = how
    half_dt, per_bend = 0.5 * dt, dt * (-1.0 / 12.0)
    twice_middle = at_middle.doubled()
    twice = half_turn.doubled().doubled()
    lag = tuple(x * per_bend for x in bent)
    duration = float(dt.sum(-1).amax()) if adaptive else 0.0
    gravity: Vector = plumb_gravity(*r_0)
    r: Vector = r_0
    v: Vector = v_0
    for k in range(passes + 1):
        fall = _turned(gravity, twice_middle)
        w = tuple(
            torch.addcmul(p, f, dt).cumsum(-1).add(x)
            for p, f, x in zip(pushed, fall, v_0, strict=True)
        )
        v = _turned_back((w[0], w[1], w[2]), twice)
        v_before = [_before(x, y) for x, y in zip(v_0, v, strict=True)]
        ways = [torch.addcmul(c, half_dt, a + b) for c, a, b in zip(lag, v_before, v, strict=True)]
        last = r
        way = [torch.cumsum(x, -1) for x in ways]
        r = (way[0] + r_0[0], way[1] + r_0[1], way[2] + r_0[2])
        if k == passes:
            break
        if adaptive and k > 0:
            change = max(float((a - b).abs().amax()) for a, b in zip(r, last, strict=True))
            if change * GRADIENT * duration * duration / 12.0 <= TOLERANCE:
                break
        middle = [
            torch.addcmul(_before(x, y), half_dt, z)
            for x, y, z in zip(r_0, r, v_before, strict=True)
        ]
        gravity = plumb_gravity(middle[0], middle[1], middle[2])
    return r, v


def _resolved(lon_0: Tensor, r: Vector, v: Vector, q_ib: Quaternion, half_turn: _Turn) -> Channels:
    """Return what was found in the meridian frame as geodetic coordinates and in local level."""
    line: Plumb = plumb_line(*r)
    per_axis = 1.0 / line.axis
    east_of_start = _Turn(r[0] * per_axis, r[1] * per_axis)
    half = torch.sqrt(0.5 + 0.5 * east_of_start.cos)
    half_east = _Turn(half, 0.5 * east_of_start.sin / half)
    out, v_e, v_z = _turned_back(v, east_of_start)
    whole = _Turn(
        half_east.cos * half_turn.cos - half_east.sin * half_turn.sin,
        half_east.sin * half_turn.cos + half_east.cos * half_turn.sin,
    )
    w, x, y, z = _to_meridian(line.sin_lat, line.cos_lat, whole)
    q_lb = product((w, -x, -y, -z), q_ib)
    # normalised: a product of many rotations drifts by rounding
    scale = 1.5 - 0.5 * sum(c * c for c in q_lb)
    return Channels(
        torch.atan2(line.sin_lat, line.cos_lat),
        lon_0 + torch.atan2(r[1], r[0]),
        line.height,
        v_e,
        line.cos_lat * v_z - line.sin_lat * out,
        line.cos_lat * out + line.sin_lat * v_z,
        *(c * scale for c in q_lb),
    )
