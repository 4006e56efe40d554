"""Increments of rotation and velocity from mean rates, coning and sculling compensated.

While a body turns about an axis that itself turns, the sum of its gyro increments is not its
rotation vector (coning), and the sum of its accelerometer increments is not its velocity
increment (sculling). Rate and force are taken as linear in time with the slope between the means
of an interval and of the one before: the two-interval algorithms of [Savage1998] and
[Savage1998b], written for unequal intervals.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError

BLOCK_ELEMENTS = 16384
"""Samples of all records together that are worked on at once: their channels fit the cache."""

Vector = tuple[Tensor, Tensor, Tensor]


class Interval(NamedTuple):
    """What the streaming form holds of the interval before.

    Attributes:
        omega_ib_b: Mean angular rate, errors removed, rad/s, shape (..., 3).
        f_b: Mean specific force, errors removed, m/s², shape (..., 3).
        dt: Length, s, shape (...); zero where there was none, which compensates nothing.
    """

    omega_ib_b: Tensor
    f_b: Tensor
    dt: Tensor


def cross(left: Tensor, right: Tensor) -> Tensor:
    """Return the cross product along the last axis.

    Args:
        left: Vectors, shape (..., 3).
        right: Vectors, shape (..., 3).

    Returns:
        left × right, shape (..., 3).
    """
    product: Tensor = torch.linalg.cross(left, right, dim=-1)
    return product


def velocity_at_start(rotation: Tensor, velocity: Tensor) -> Tensor:
    """Return what a body felt while it turned, resolved in the body at the start.

    Rate and force constant in the body; [Groves2013] §5.5.2.

    Args:
        rotation: Angle turned over the interval, rad, shape (..., 3).
        velocity: Integral of specific force in the turning body, m/s, shape (..., 3).

    Returns:
        Velocity increment, m/s, shape (..., 3).
    """
    a, b, c = torch.unbind(rotation, -1)
    x, y, z = torch.unbind(velocity, -1)
    return torch.stack(_at_start((a, b, c), (x, y, z)), -1)


def coning_sculling_step(
    omega_ib_b: Tensor, f_b: Tensor, dt: Tensor, before: Interval | None = None
) -> tuple[Tensor, Tensor]:
    """Return the increments of one interval, given the one before; scriptable.

    Args:
        omega_ib_b: Mean angular rate, errors removed, rad/s, shape (..., 3).
        f_b: Mean specific force, errors removed, m/s², shape (..., 3).
        dt: Length of the interval, s, shape (...); zero gives zeros.
        before: The interval before; None compensates only the turn within the interval.

    Returns:
        Rotation vector (rad) and velocity increment in the body at the start of the interval
        (m/s), shape (..., 3) each.
    """
    w_x, w_y, w_z = torch.unbind(omega_ib_b, -1)
    f_x, f_y, f_z = torch.unbind(f_b, -1)
    if before is None:
        zero = torch.zeros_like(dt)
        rotation, velocity = _compensated(
            (w_x, w_y, w_z), (f_x, f_y, f_z), dt, (zero, zero, zero), (zero, zero, zero), zero
        )
    else:
        p_x, p_y, p_z = torch.unbind(before.omega_ib_b, -1)
        g_x, g_y, g_z = torch.unbind(before.f_b, -1)
        rotation, velocity = _compensated(
            (w_x, w_y, w_z), (f_x, f_y, f_z), dt, (p_x, p_y, p_z), (g_x, g_y, g_z), before.dt
        )
    return torch.stack(rotation, -1), torch.stack(velocity, -1)


def coning_sculling(
    omega_ib_b: Tensor, f_b: Tensor, dt: Tensor, previous: Interval | None = None
) -> tuple[Tensor, Tensor]:
    """Return the increments of all intervals of records.

    Equals :func:`coning_sculling_step` with each interval handed on to the next.

    Args:
        omega_ib_b: Mean angular rates, errors removed, rad/s, shape (..., T, 3).
        f_b: Mean specific forces, errors removed, m/s², shape (..., T, 3).
        dt: Length of the intervals, s, shape (..., T); zero marks padding.
        previous: The interval before the first, shape (...) each; None if there is none.

    Returns:
        Rotation vectors (rad) and velocity increments in the body at the start of each interval
        (m/s), shape (..., T, 3) each; their axes lie apart in memory.

    Raises:
        ShapeError: If rates, forces and intervals do not go together.
    """
    check_channels("coning_sculling", omega_ib_b, f_b, dt)
    if previous is None:
        nothing = torch.zeros_like(omega_ib_b[..., :1, :]).sum(-2)
        previous = Interval(nothing, nothing, nothing[..., 0])
    rates, forces = (
        torch.cat((first.unsqueeze(-1).movedim(-2, 0), x.movedim(-1, 0)), -1)
        for first, x in ((previous.omega_ib_b, omega_ib_b), (previous.f_b, f_b))
    )
    times = torch.cat((previous.dt.unsqueeze(-1), dt), -1)
    length = dt.shape[-1]
    size = max(BLOCK_ELEMENTS // max(dt.shape[:-1].numel(), 1), 64)
    rotations, velocities = [], []
    for k in range(0, max(length, 1), size):
        n = min(size, length - k)
        before, now = (x.narrow(-1, i, n) for x in (times,) for i in (k, k + 1))
        (w_0, w), (f_0, f) = (
            tuple(_of(x.narrow(-1, i, n)) for i in (k, k + 1)) for x in (rates, forces)
        )
        rotation, velocity = _compensated(w, f, now, w_0, f_0, before)
        rotations.append(torch.stack(rotation))
        velocities.append(torch.stack(velocity))
    return torch.cat(rotations, -1).movedim(0, -1), torch.cat(velocities, -1).movedim(0, -1)


def check_channels(where: str, rotation: Tensor, velocity: Tensor, dt: Tensor) -> None:
    """Refuse two vector channels and intervals that do not go together.

    Args:
        where: Name of the function, for the message.
        rotation: First channel, shape (..., T, 3).
        velocity: Second channel, shape (..., T, 3).
        dt: Intervals, shape (..., T).

    Raises:
        ShapeError: If the shapes differ.
    """
    if rotation.shape != (*dt.shape, 3) or velocity.shape != rotation.shape:
        raise ShapeError(
            f"{where}: rates have shape {tuple(rotation.shape)}, forces {tuple(velocity.shape)}, "
            f"dt {tuple(dt.shape)}; expected (..., T, 3) twice and (..., T): put x, y, z last"
        )


def _compensated(
    w: Vector, f: Vector, dt: Tensor, w_before: Vector, f_before: Vector, dt_before: Tensor
) -> tuple[Vector, Vector]:
    """Return rotation and velocity of intervals from theirs and the means before, per axis.

    With rate and force linear in time, coning adds dt³/12 ω̄ × ω̇ to the rotation and sculling
    dt³/12 (ω̄ × ḟ + f̄ × ω̇) to the velocity; the slope is 2 (ω − ω_before)/(dt + dt_before).
    """
    there = (dt_before > 0.0) & (dt > 0.0)
    span = torch.where(there, dt + dt_before, 1.0)
    factor = torch.where(there, dt * dt * dt / (6.0 * span), 0.0)
    turn = (w[0] * dt, w[1] * dt, w[2] * dt)
    push = (f[0] * dt, f[1] * dt, f[2] * dt)
    c_x, c_y, c_z = _cross(w_before, w)
    s_x, s_y, s_z = _cross(w_before, f)
    t_x, t_y, t_z = _cross(f_before, w)
    v_x, v_y, v_z = _at_start(turn, push)
    rotation = (
        torch.addcmul(turn[0], factor, c_x),
        torch.addcmul(turn[1], factor, c_y),
        torch.addcmul(turn[2], factor, c_z),
    )
    velocity = (
        torch.addcmul(v_x, factor, s_x + t_x),
        torch.addcmul(v_y, factor, s_y + t_y),
        torch.addcmul(v_z, factor, s_z + t_z),
    )
    return rotation, velocity


def _at_start(turn: Vector, push: Vector) -> Vector:
    """Return what a body felt while it turned, resolved in the body at the start.

    ∫ C f dt with rate and force constant in the body: (1 − cos α)/α² and (α − sin α)/α³ by their
    series, exact to 1e-9 of the increment for half a radian. [Groves2013] §5.5.2.
    """
    x, y, z = turn
    a = torch.addcmul(torch.addcmul(x * x, y, y), z, z)
    by_once = 0.5 - a * (1.0 / 24.0 - a * (1.0 / 720.0 - a * (1.0 / 40320.0)))
    by_twice = 1.0 / 6.0 - a * (1.0 / 120.0 - a * (1.0 / 5040.0 - a * (1.0 / 362880.0)))
    b = _cross(turn, push)
    c = _cross(turn, b)
    return (
        torch.addcmul(torch.addcmul(push[0], by_once, b[0]), by_twice, c[0]),
        torch.addcmul(torch.addcmul(push[1], by_once, b[1]), by_twice, c[1]),
        torch.addcmul(torch.addcmul(push[2], by_once, b[2]), by_twice, c[2]),
    )


def _cross(a: Vector, b: Vector) -> Vector:
    return (
        torch.addcmul(a[1] * b[2], a[2], b[1], value=-1.0),
        torch.addcmul(a[2] * b[0], a[0], b[2], value=-1.0),
        torch.addcmul(a[0] * b[1], a[1], b[0], value=-1.0),
    )


def _of(channels: Tensor) -> Vector:
    x, y, z = channels.unbind(0)
    return x, y, z
