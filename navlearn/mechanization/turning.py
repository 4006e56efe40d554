"""Rotation of a body against the local level over a stretch of samples, one drive at a time."""

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import matrix_from_quaternion
from navlearn.mechanization.preintegration_turn import prefix_products, quaternions_of


def turned_since_start(omega: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
    """Return how a body stands against where it stood before the first interval.

    Args:
        omega: Mean angular rate of the body against the frame in question, rad/s, shape (T, 3).
        dt: Lengths of the intervals, s, shape (T,).

    Returns:
        Rotation matrices that turn the body into the body at the start: in the middle of every
        interval and at its end, shape (T, 3, 3) each.
    """
    turn = omega * dt.unsqueeze(-1)
    steps = quaternions_of(turn.transpose(0, 1).unsqueeze(1))
    q = torch.stack(prefix_products(steps), -1)[0]
    q = q / torch.linalg.vector_norm(q, dim=-1, keepdim=True)
    back = torch.stack(quaternions_of(-0.5 * turn.transpose(0, 1)), -1)
    end = matrix_from_quaternion(q)
    return end @ matrix_from_quaternion(back), end


def level_rate(lat: Tensor, height: Tensor, v_l: Tensor) -> Tensor:
    """Return the rate at which the local level turns against inertial space.

    Args:
        lat: Latitude, rad, shape (...).
        height: Height, m, shape (...).
        v_l: Velocity east, north, up, m/s, shape (..., 3).

    Returns:
        ω_il resolved in local level, rad/s, shape (..., 3).
    """
    transport = earth.transport_rate_enu(lat, height, v_l[..., 0], v_l[..., 1])
    return earth.earth_rate_enu(lat) + transport
