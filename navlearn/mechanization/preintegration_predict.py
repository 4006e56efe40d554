"""From a state over a preintegrated window to the next state.

Over a window of a few seconds the Earth turns evenly and its gravity is nearly uniform, so in
axes fixed to the Earth at the start the window's motion is a closed formula of its increments:
Coriolis and the Earth's turning to second order in ω T, gravity's change along the way to first
order. The end is then told in geodetic coordinates and the axes there ([Groves2013] §5.4 for
the equations of motion).
"""

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import quaternion_from_rotation_vector, quaternion_multiply
from navlearn.mechanization.coning import cross
from navlearn.mechanization.earth_fixed import turned_back, unit
from navlearn.mechanization.local_level import geodetic_change
from navlearn.mechanization.preintegration_window import Preintegrated
from navlearn.states import InsState


def corrected(pre: Preintegrated, change: Tensor | None) -> Preintegrated:
    """Return increments for other sensor parameters, to first order.

    Args:
        pre: Increments, shape (...).
        change: New parameters minus those taken off in preintegration, in the order of
            :class:`Preintegrated`; more of them than it has are ignored, shape (..., m). None
            means no change.

    Returns:
        Increments, shape (...).
    """
    if change is None:
        return pre
    count = min(change.shape[-1], pre.by_sensor.shape[-1])
    known = pre.by_sensor[..., :count] @ change[..., :count].unsqueeze(-1)
    moved = known.squeeze(-1)
    turn = quaternion_from_rotation_vector(moved[..., 6:])
    return Preintegrated(
        pre.duration,
        quaternion_multiply(turn, pre.rotation),
        pre.velocity + moved[..., 3:6],
        pre.position + moved[..., :3],
        pre.by_sensor,
        pre.covariance,
    )


def rotated(quaternion: Tensor, vector: Tensor) -> Tensor:
    """Return a vector turned by a unit quaternion.

    Args:
        quaternion: Scalar first, shape (..., 4).
        vector: Shape (..., 3).

    Returns:
        Shape (..., 3).
    """
    axis = quaternion[..., 1:]
    across = 2.0 * cross(axis, vector)
    return vector + quaternion[..., :1] * across + cross(axis, across)


def predict(state: InsState, pre: Preintegrated, change: Tensor | None = None) -> InsState:
    """Return the state at the end of a window.

    Args:
        state: State at its start, shape (...).
        pre: The window's increments, shape (...).
        change: Sensor parameters minus those taken off in preintegration, shape (..., m); None
            means no change.

    Returns:
        State, shape (...).
    """
    return predict_with_way(state, corrected(pre, change))[0]


def predict_with_way(state: InsState, inc: Preintegrated) -> tuple[InsState, Tensor]:
    """Return the state at the end of a window, and how the window leads there.

    Args:
        state: State at its start, shape (...).
        inc: The window's increments, shape (...).

    Returns:
        State, and the way east, north, up in the axes of the start, m, shape (..., 3): digits that
        a latitude does not keep.
    """
    T = inc.duration.unsqueeze(-1)
    omega = earth.earth_rate_enu(state.lat)
    gamma = earth.normal_gravity(state.lat, state.height)
    r_m, r_n = earth.meridian_radius(state.lat), earth.prime_vertical_radius(state.lat)
    zero = torch.zeros_like(gamma)
    gravity = torch.stack((zero, zero, -gamma), dim=-1)
    position, velocity = rotated(state.q_lb, inc.position), rotated(state.q_lb, inc.velocity)
    coasted = state.v_l * T
    way = coasted + position + 0.5 * T * T * gravity
    slope = torch.stack(
        (-gamma / (r_n + state.height), -gamma / (r_m + state.height), 2.0 * gamma / r_m), dim=-1
    )
    pulled = slope * T * (coasted / 6.0 + way / 3.0)
    fallen = T * T * gravity
    first = 2.0 * way - position + T * velocity
    second = T * (0.5 * T * velocity + 4.0 / 3.0 * position + 2.0 / 3.0 * fallen + 2.0 * coasted)
    speed = state.v_l + velocity + T * gravity + pulled - _held_back(omega, first, second)
    pulled = slope * T * T * (coasted + way) / 12.0
    first = T * (way - fallen / 6.0)
    second = T * T * (7.0 / 12.0 * position + fallen / 6.0 + 2.0 / 3.0 * coasted)
    way = way + pulled - _held_back(omega, first, second)
    return _told_there(state, inc, way, speed), way


def _held_back(omega: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """Return what the turning of the Earth takes off, by its first and second order."""
    return cross(omega, first - cross(omega, second))


def _told_there(state: InsState, inc: Preintegrated, way: Tensor, velocity: Tensor) -> InsState:
    """Return the state in geodetic coordinates and the axes of its new place."""
    moved = geodetic_change(state.lat, state.height, way)
    middle = state.lat + 0.5 * moved.lat
    place = torch.stack(
        (-moved.lat, moved.lon * torch.cos(middle), moved.lon * torch.sin(middle)), dim=-1
    )
    level = place + inc.duration.unsqueeze(-1) * earth.earth_rate_enu(middle)
    turn = quaternion_from_rotation_vector(-level)
    return InsState(
        state.lat + moved.lat,
        state.lon + moved.lon,
        state.height + moved.height,
        turned_back(velocity, place),
        unit(quaternion_multiply(quaternion_multiply(turn, state.q_lb), inc.rotation)),
    )
