"""Attitude of the body in the local-level frame: angles, matrices, quaternions.

Azimuth is clockwise from north, pitch nose up, roll right side down; ENU and RFU axes.
Quaternions are scalar first, Hamilton, and turn body into local level.
Source: [Noureldin2013] §2.3, with the azimuth sign of this package.
"""

import math

import torch
from torch import Tensor


def wrap_angle(angle: Tensor) -> Tensor:
    """Return an angle wrapped to [−π, π).

    Args:
        angle: Angle, rad, shape (...).

    Returns:
        The same direction, rad, shape (...).
    """
    return torch.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


def matrix_from_angles(azimuth: Tensor, pitch: Tensor, roll: Tensor) -> Tensor:
    """Return C_lb, which turns a body vector (RFU) into local level (ENU).

    C_lb = R_z(−azimuth) R_x(pitch) R_y(roll), [Noureldin2013] Eq. (2.51).

    Args:
        azimuth: Azimuth of the forward axis, rad, clockwise from north, shape (...).
        pitch: Pitch, rad, nose up, shape (...).
        roll: Roll, rad, right side down, shape (...).

    Returns:
        Rotation matrix, shape (..., 3, 3).
    """
    sa, ca = torch.sin(azimuth), torch.cos(azimuth)
    sp, cp = torch.sin(pitch), torch.cos(pitch)
    sr, cr = torch.sin(roll), torch.cos(roll)
    row_e = torch.stack((ca * cr + sa * sp * sr, sa * cp, ca * sr - sa * sp * cr), dim=-1)
    row_n = torch.stack((-sa * cr + ca * sp * sr, ca * cp, -sa * sr - ca * sp * cr), dim=-1)
    row_u = torch.stack((-cp * sr, sp, cp * cr), dim=-1)
    return torch.stack((row_e, row_n, row_u), dim=-2)


def angles_from_matrix(C_lb: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return azimuth, pitch and roll of a rotation matrix.

    Args:
        C_lb: Rotation from body (RFU) to local level (ENU), shape (..., 3, 3).

    Returns:
        Azimuth in [−π, π), pitch in [−π/2, π/2], roll in [−π, π), rad, each of shape (...).
    """
    pitch = torch.asin(C_lb[..., 2, 1].clamp(-1.0, 1.0))
    roll = torch.atan2(-C_lb[..., 2, 0], C_lb[..., 2, 2])
    azimuth = torch.atan2(C_lb[..., 0, 1], C_lb[..., 1, 1])
    return azimuth, pitch, roll


def quaternion_multiply(left: Tensor, right: Tensor) -> Tensor:
    """Return the Hamilton product of two quaternions.

    Args:
        left: Scalar-first quaternion, shape (..., 4).
        right: Scalar-first quaternion, shape (..., 4).

    Returns:
        left ⊗ right, shape (..., 4).
    """
    a, b, c, d = left.unbind(-1)
    e, f, g, h = right.unbind(-1)
    return torch.stack(
        (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ),
        dim=-1,
    )


def quaternion_from_rotation_vector(rotation: Tensor) -> Tensor:
    """Return the quaternion of a rotation vector, smooth at zero.

    Args:
        rotation: Axis times angle, rad, shape (..., 3).

    Returns:
        Unit quaternion, scalar first, shape (..., 4).
    """
    angle2 = (rotation * rotation).sum(-1, keepdim=True)
    small = angle2 < 1e-8
    angle = torch.sqrt(torch.where(small, torch.ones_like(angle2), angle2))
    ratio = torch.where(small, 0.5 - angle2 / 48.0, torch.sin(0.5 * angle) / angle)
    scalar = torch.where(small, 1.0 - angle2 / 8.0 + angle2**2 / 384.0, torch.cos(0.5 * angle))
    return torch.cat((scalar, ratio * rotation), dim=-1)


def matrix_from_quaternion(quaternion: Tensor) -> Tensor:
    """Return the rotation matrix of a unit quaternion.

    Args:
        quaternion: Scalar-first unit quaternion, shape (..., 4).

    Returns:
        Rotation matrix, shape (..., 3, 3).
    """
    w, x, y, z = quaternion.unbind(-1)
    row0 = torch.stack((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)), dim=-1)
    row1 = torch.stack((2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)), dim=-1)
    row2 = torch.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), dim=-1)
    return torch.stack((row0, row1, row2), dim=-2)


def quaternion_from_angles(azimuth: Tensor, pitch: Tensor, roll: Tensor) -> Tensor:
    """Return the quaternion that turns body (RFU) into local level (ENU).

    Args:
        azimuth: Azimuth of the forward axis, rad, clockwise from north, shape (...).
        pitch: Pitch, rad, nose up, shape (...).
        roll: Roll, rad, right side down, shape (...).

    Returns:
        Scalar-first unit quaternion, shape (..., 4).
    """
    zero = torch.zeros_like(azimuth)
    turn = torch.stack((torch.cos(azimuth / 2), zero, zero, -torch.sin(azimuth / 2)), dim=-1)
    climb = torch.stack((torch.cos(pitch / 2), torch.sin(pitch / 2), zero, zero), dim=-1)
    bank = torch.stack((torch.cos(roll / 2), zero, torch.sin(roll / 2), zero), dim=-1)
    return quaternion_multiply(quaternion_multiply(turn, climb), bank)


def quaternion_from_matrix(matrix: Tensor) -> Tensor:
    """Return the unit quaternion of a rotation matrix, its scalar not negative.

    [Markley2008]: each row of 4 q qᵀ is q times one of its components; the longest row is taken,
    so that no rotation is lost to rounding.

    Args:
        matrix: Rotation matrix, shape (..., 3, 3).

    Returns:
        Scalar-first unit quaternion, shape (..., 4).
    """
    a, b, c = torch.diagonal(matrix, dim1=-2, dim2=-1).unbind(-1)
    w_x = matrix[..., 2, 1] - matrix[..., 1, 2]
    w_y = matrix[..., 0, 2] - matrix[..., 2, 0]
    w_z = matrix[..., 1, 0] - matrix[..., 0, 1]
    x_y = matrix[..., 1, 0] + matrix[..., 0, 1]
    x_z = matrix[..., 0, 2] + matrix[..., 2, 0]
    y_z = matrix[..., 2, 1] + matrix[..., 1, 2]
    rows = torch.stack(
        (
            torch.stack((1.0 + a + b + c, w_x, w_y, w_z), dim=-1),
            torch.stack((w_x, 1.0 + a - b - c, x_y, x_z), dim=-1),
            torch.stack((w_y, x_y, 1.0 - a + b - c, y_z), dim=-1),
            torch.stack((w_z, x_z, y_z, 1.0 - a - b + c), dim=-1),
        ),
        dim=-2,
    )
    longest = torch.diagonal(rows, dim1=-2, dim2=-1).argmax(-1)
    row = torch.take_along_dim(rows, longest[..., None, None], dim=-2).squeeze(-2)
    length = torch.sqrt((row * row).sum(-1, keepdim=True))
    return torch.where(row[..., :1] < 0.0, -row, row) / length


def angles_from_quaternion(quaternion: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return azimuth, pitch and roll of the quaternion that turns body into local level.

    Args:
        quaternion: Scalar-first unit quaternion q_lb, shape (..., 4).

    Returns:
        Azimuth in [−π, π), pitch in [−π/2, π/2], roll in [−π, π), rad, each of shape (...).
    """
    return angles_from_matrix(matrix_from_quaternion(quaternion))
