"""Increments of rotation and velocity from mean rates, coning and sculling compensated.

While a body turns about an axis that itself turns, the sum of its gyro increments is not its
rotation vector (coning), and the sum of its accelerometer increments is not its velocity
increment (sculling). Rate and force are taken as linear in time with the slope between the means
of an interval and of the one before: the two-interval algorithms
of [Savage1998] and [Savage1998b], written for unequal intervals.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError


class Interval(NamedTuple):
    """What the streaming form holds of the interval before.

    Attributes:
        omega_ib_b: Mean angular rate, rad/s, shape (..., 3).
        f_b: Mean specific force, m/s², shape (..., 3).
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

    ∫ C f dt with rate and force constant in the body: (1 − cos α)/α² and (α − sin α)/α³ by their
    series, exact to 1e-9 of the increment for half a radian. [Groves2013] §5.5.2.

    Args:
        rotation: Angle turned over the interval α, rad, shape (..., 3).
        velocity: Integral of specific force in the turning body, m/s, shape (..., 3).

    Returns:
        Velocity increment, m/s, shape (..., 3).
    """
    a = (rotation * rotation).sum(-1, keepdim=True)
    once = cross(rotation, velocity)
    by_once = 0.5 - a * (1.0 / 24.0 - a * (1.0 / 720.0 - a / 40320.0))
    by_twice = 1.0 / 6.0 - a * (1.0 / 120.0 - a * (1.0 / 5040.0 - a / 362880.0))
    return velocity + by_once * once + by_twice * cross(rotation, once)


def coning_sculling_step(
    omega_ib_b: Tensor, f_b: Tensor, dt: Tensor, before: Interval | None = None
) -> tuple[Tensor, Tensor]:
    """Return the increments of one interval, given the one before; scriptable.

    With rate and force linear in time, coning adds dt³/12 ω̄ × ω̇ to the rotation and sculling
    dt³/12 (ω̄ × ḟ + f̄ × ω̇) to the velocity.

    Args:
        omega_ib_b: Mean angular rate, errors removed, rad/s, shape (..., 3).
        f_b: Mean specific force, errors removed, m/s², shape (..., 3).
        dt: Length of the interval, s, shape (...); zero gives zeros.
        before: The interval before; None compensates only the turn within the interval.

    Returns:
        Rotation vector (rad) and velocity increment in the body at the start of the interval
        (m/s), shape (..., 3) each.
    """
    h = dt.unsqueeze(-1)
    rotation = omega_ib_b * h
    velocity = velocity_at_start(rotation, f_b * h)
    if before is None:
        return rotation, velocity
    there = (before.dt > 0.0) & (dt > 0.0)
    span = torch.where(there, dt + before.dt, torch.ones_like(dt))
    # slope = 2 (ω − ω_before)/(dt + dt_before), and ω × ω vanishes
    factor = torch.where(there, dt * dt * dt / (6.0 * span), torch.zeros_like(dt)).unsqueeze(-1)
    coning = cross(before.omega_ib_b, omega_ib_b)
    sculling = cross(before.omega_ib_b, f_b) + cross(before.f_b, omega_ib_b)
    return rotation + factor * coning, velocity + factor * sculling


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
        (m/s), shape (..., T, 3) each.

    Raises:
        ShapeError: If rates, forces and intervals do not go together.
    """
    check_channels("coning_sculling", omega_ib_b, f_b, dt)
    if previous is None:
        first = dt[..., :1]
        nothing = torch.zeros_like(omega_ib_b[..., :1, :])
        previous = Interval(nothing, nothing, torch.zeros_like(first))
    else:
        previous = Interval(
            previous.omega_ib_b.unsqueeze(-2), previous.f_b.unsqueeze(-2), previous.dt.unsqueeze(-1)
        )
    before = Interval(
        torch.cat((previous.omega_ib_b, omega_ib_b[..., :-1, :]), -2),
        torch.cat((previous.f_b, f_b[..., :-1, :]), -2),
        torch.cat((previous.dt, dt[..., :-1]), -1),
    )
    return coning_sculling_step(omega_ib_b, f_b, dt, before)


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
