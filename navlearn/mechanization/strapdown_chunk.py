"""One chunk of the parallel strapdown: from increments to the solution, all samples at once.

The meridian frame of the record's start (:mod:`navlearn.mechanization.meridian`) is fixed to the
Earth; the inertial frame is the one that coincided with it at the start. Against inertial space
the attitude is a product of known rotations, so what a force adds there is known, too. Arrays lie
as (records, samples), one per axis or (3, records, samples).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.mechanization.meridian import level_to_meridian, plumb_line
from navlearn.mechanization.preintegration_turn import conjugate, product
from navlearn.mechanization.quaternion_scan import Quaternion
from navlearn.mechanization.strapdown_path import Pushed, path, turned, turned_back


class Chunk(NamedTuple):
    """What leads through a chunk of n intervals, and where it starts.

    Attributes:
        r: Position at the start, meridian frame, m, shape (3, B, 1).
        v: Velocity at the start, meridian frame, m/s, shape (3, B, 1).
        time: Time since the record's start at the ends of the intervals, s, shape (B, n).
        dt: Length of the intervals, s, shape (B, n).
        turn: Rotation vectors, rad, shape (3, B, n).
        push: Velocity increments in the body at the start of each interval, m/s, (3, B, n).
        q_w: Scalar of the quaternion from body to inertial frame, at the start of the first
            interval and at the ends of all, shape (B, n + 1).
        q_x: Its first component, shape likewise.
        q_y: Its second component, shape likewise.
        q_z: Its third component, shape likewise.
        lon: Longitude of the record's start, rad, shape (B, 1).
    """

    r: Tensor
    v: Tensor
    time: Tensor
    dt: Tensor
    turn: Tensor
    push: Tensor
    q_w: Tensor
    q_x: Tensor
    q_y: Tensor
    q_z: Tensor
    lon: Tensor

    @property
    def attitude(self) -> Quaternion:
        """Quaternion from body to inertial frame, shape (B, n + 1) each."""
        return self.q_w, self.q_x, self.q_y, self.q_z


class Solved(NamedTuple):
    """A solution.

    Attributes:
        place: Latitude (rad), longitude (rad), height (m), shape (3, B, n).
        v: Velocity east, north, up, m/s, shape (3, B, n).
        attitude: Quaternions from body to local level, shape (4, B, n).
        r_end: Position at the end, meridian frame, m, shape (3, B, 1).
        v_end: Velocity at the end, meridian frame, m/s, shape (3, B, 1).
    """

    place: Tensor
    v: Tensor
    attitude: Tensor
    r_end: Tensor
    v_end: Tensor


def move_chunk(chunk: Chunk, adaptive: bool = True) -> Solved:
    """Return the solution at the ends of a chunk's intervals.

    Args:
        chunk: What leads through it.
        adaptive: Whether a chunk that is short enough goes without corrections of gravity.

    Returns:
        The solution.
    """
    half_angle = (0.5 * wgs84.EARTH_RATE) * chunk.time
    half_turn = torch.cos(half_angle), torch.sin(half_angle)
    pushed = _pushed(chunk, _doubled(*_doubled(*half_turn)))
    way, v = path(chunk.r, chunk.v, pushed, adaptive)
    r = chunk.r + way
    place, v_l, attitude = _resolved(r, v, chunk, half_turn)
    return Solved(place, v_l, attitude, r[..., -1:], v[..., -1:])


def _pushed(chunk: Chunk, at_end: tuple[Tensor, Tensor]) -> Pushed:
    dt = chunk.dt
    angle = wgs84.EARTH_RATE * (chunk.time - 0.5 * dt)
    cos, sin = torch.cos(angle), torch.sin(angle)
    (a, b, c), (x, y, z) = chunk.turn.unbind(0), chunk.push.unbind(0)
    across = torch.stack((b * z - c * y, c * x - a * z, a * y - b * x))
    q = [x[:, :-1] for x in chunk.attitude]
    forces = _rotated(q, torch.stack((chunk.push, across), 1))
    added = turned(forces[:, 0], cos, sin)
    lag = turned_back(_bent(forces, wgs84.EARTH_RATE * dt), cos, sin) * (dt * (-1.0 / 12.0))
    # twice the Earth's angle at the chunk's start
    angle = (2.0 * wgs84.EARTH_RATE) * (chunk.time[:, :1] - dt[:, :1])
    v_0 = turned(chunk.v, torch.cos(angle), torch.sin(angle))
    total = torch.cumsum(added, -1) + v_0
    return Pushed(total, lag, dt, _doubled(cos, sin), at_end)


def _bent(forces: Tensor, turn_of_earth: Tensor) -> Tensor:
    """Return how forces turn against the Earth; they turn by the body's rotation, less its own."""
    (u_x, b_x), (u_y, b_y), (_, b_z) = (x.unbind(0) for x in forces.unbind(0))
    return torch.stack(
        (
            torch.addcmul(b_x, turn_of_earth, u_y),
            torch.addcmul(b_y, turn_of_earth, u_x, value=-1.0),
            b_z,
        )
    )


def _rotated(q: list[Tensor], vectors: Tensor) -> Tensor:
    """Return vectors, (3, 2, B, n), turned by unit quaternions, (B, n) per component."""
    w, x, y, z = q
    x2, y2, z2 = x + x, y + y, z + z
    wx, wy, wz, xy, xz, yz = w * x2, w * y2, w * z2, x * y2, x * z2, y * z2
    xx, yy, zz = 1.0 - x * x2, y * y2, z * z2
    a, b, c = vectors.unbind(0)
    more = torch.addcmul
    return torch.stack(
        (
            more(more((1.0 - yy - zz) * a, xy - wz, b), xz + wy, c),
            more(more((xy + wz) * a, xx - zz, b), yz - wx, c),
            more(more((xz - wy) * a, yz + wx, b), xx - yy, c),
        )
    )


def _doubled(cos: Tensor, sin: Tensor) -> tuple[Tensor, Tensor]:
    return cos * cos - sin * sin, 2.0 * cos * sin


def _resolved(
    r: Tensor, v: Tensor, chunk: Chunk, half_turn: tuple[Tensor, Tensor]
) -> tuple[Tensor, Tensor, Tensor]:
    """Return what was found in the meridian frame, geodetic and in local level."""
    x, y, z = r.unbind(0)
    sin_lat, cos_lat, axis, height = plumb_line(x, y, z)
    per_axis = 1.0 / axis
    cos, sin = x * per_axis, y * per_axis
    v_x, v_y, v_z = v.unbind(0)
    out = torch.addcmul(v_x * cos, v_y, sin)
    v_l = torch.stack(
        (
            v_y * cos - v_x * sin,
            v_z * cos_lat - out * sin_lat,
            torch.addcmul(out * cos_lat, v_z, sin_lat),
        )
    )
    half_cos = torch.sqrt(0.5 + 0.5 * cos)
    half_sin = 0.5 * sin / half_cos
    a, b = half_turn
    level = level_to_meridian(
        sin_lat, cos_lat, half_cos * a - half_sin * b, torch.addcmul(half_sin * a, half_cos, b)
    )
    w, i, j, k = (x[:, 1:] for x in chunk.attitude)
    q = torch.stack(product(conjugate(level), (w, i, j, k)))
    place = torch.stack((torch.atan2(sin_lat, cos_lat), chunk.lon + torch.atan2(y, x), height))
    # a product of many rotations drifts from unit length by rounding
    return place, v_l, q * (1.5 - 0.5 * (q * q).sum(0))
