"""Linear dynamics of the full-IMU error state: F and the spectral density of its noise.

The φ-angle model in the local level [Groves2013] §14.2.4, [Noureldin2013] §6.2, turned from NED
to ENU and with position errors in metres (δλ (R_N + h) cos φ, δφ (R_M + h), δh), so that nothing
is scaled by 10⁶. Errors are estimate minus truth, Ĉ_lb = (I + [φ×]) C_lb:

* δṗ = δv + what the changing metres per radian do;
* δv̇ = −[f_l×] φ + C_lb δf − (2ω_ie + ω_el) × δv + [v×](2δω_ie + δω_el) + δg;
* φ̇ = −ω_il × φ + C_lb δω − δω_ie − δω_el.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth, wgs84
from navlearn.attitude import matrix_from_quaternion
from navlearn.fusion.ins.layout import ImuErrors, InsLayout
from navlearn.states import InsState


class Motion(NamedTuple):
    """Where and how the car moves, as the linear model needs it, batch shape (...).

    Attributes:
        lat: Latitude, rad, shape (...).
        height: Height, m, shape (...).
        v_l: Velocity, ENU, m/s, shape (..., 3).
        C_lb: Body to local level, shape (..., 3, 3).
        omega_ib_b: Angular rate, sensor errors removed, rad/s, shape (..., 3).
        f_b: Specific force, sensor errors removed, m/s², shape (..., 3).
    """

    lat: Tensor
    height: Tensor
    v_l: Tensor
    C_lb: Tensor
    omega_ib_b: Tensor
    f_b: Tensor


def motion_between(before: InsState, after: InsState, omega: Tensor, force: Tensor) -> Motion:
    """Return the motion in the middle of an interval.

    Args:
        before: State at its start, batch shape (...).
        after: State at its end, batch shape (...).
        omega: Mean angular rate, sensor errors removed, rad/s, shape (..., 3).
        force: Mean specific force, sensor errors removed, m/s², shape (..., 3).

    Returns:
        Motion.
    """
    # q and −q are one attitude
    sign = torch.where((before.q_lb * after.q_lb).sum(-1, keepdim=True) < 0.0, -1.0, 1.0)
    middle = before.q_lb + sign * after.q_lb
    C_lb = matrix_from_quaternion(middle / middle.norm(dim=-1, keepdim=True))
    return Motion(
        0.5 * (before.lat + after.lat),
        0.5 * (before.height + after.height),
        0.5 * (before.v_l + after.v_l),
        C_lb,
        omega,
        force,
    )


def skew(vector: Tensor) -> Tensor:
    """Return [v×], the matrix of the cross product by a vector from the left.

    Args:
        vector: Shape (..., 3).

    Returns:
        Shape (..., 3, 3).
    """
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def phi_angle_dynamics(layout: InsLayout, motion: Motion, errors: ImuErrors, tau: float) -> Tensor:
    """Return F of the complete φ-angle model.

    Args:
        layout: Order of the error states.
        motion: Motion, batch shape (...).
        errors: Sensor parameters, batch shape (...).
        tau: Correlation time of the biases, s; infinite for random walks.

    Returns:
        F, 1/s, shape (..., n, n).
    """
    r_m = earth.meridian_radius(motion.lat) + motion.height
    r_n = earth.prime_vertical_radius(motion.lat) + motion.height
    tan = torch.tan(motion.lat)
    v_e, v_n, v_u = motion.v_l.unbind(-1)
    zero = torch.zeros_like(tan)
    rate_ie = earth.earth_rate_enu(motion.lat)
    rate_el = torch.stack((-v_n / r_m, v_e / r_n, v_e * tan / r_n), -1)
    # δω_ie and δω_el by position and velocity errors
    by_velocity = _matrix(
        ((zero, -1.0 / r_m, zero), (1.0 / r_n, zero, zero), (tan / r_n, zero, zero))
    )
    bend = v_e * (1.0 + tan * tan) / (r_n * r_m)
    by_position = _matrix(
        (
            (zero, zero, v_n / (r_m * r_m)),
            (zero, zero, -v_e / (r_n * r_n)),
            (zero, bend, -v_e * tan / (r_n * r_n)),
        )
    )
    turned = _matrix(
        (
            (zero, zero, zero),
            (zero, -rate_ie[..., 2] / r_m, zero),
            (zero, rate_ie[..., 1] / r_m, zero),
        )
    )
    gravity = torch.zeros_like(by_position)
    gravity[..., 2, 2] = gravity_gradient(motion.lat, motion.height)
    across = skew(motion.v_l)
    metres = _matrix(
        (
            (v_u / r_n - v_n * tan / r_m, v_e * tan / r_m, -v_e / r_n),
            (zero, v_u / r_m, -v_n / r_m),
            (zero, zero, zero),
        )
    )
    eye = torch.eye(3, dtype=tan.dtype, device=tan.device).expand_as(metres)
    top = (metres, eye, torch.zeros_like(metres))
    middle = (
        across @ (2.0 * turned + by_position) + gravity,
        across @ by_velocity - skew(2.0 * rate_ie + rate_el),
        -skew(_times(motion.C_lb, motion.f_b)),
    )
    low = (-turned - by_position, -by_velocity, -skew(rate_ie + rate_el))
    return with_sensors(layout, _blocks((top, middle, low)), motion, errors, tau)


def with_sensors(
    layout: InsLayout, core: Tensor, motion: Motion, errors: ImuErrors, tau: float
) -> Tensor:
    """Return F of navigation and sensor errors from that of navigation errors.

    Too large a bias or scale makes the corrected rate and force too small, hence the signs.

    Args:
        layout: Order of the error states.
        core: F of position, velocity and attitude errors, shape (..., 9, 9).
        motion: Motion, batch shape (...).
        errors: Sensor parameters, batch shape (...).
        tau: Correlation time of the biases, s; infinite for random walks.

    Returns:
        F, shape (..., n, n).
    """
    n = layout.size
    F = torch.nn.functional.pad(core, (0, n - 9, 0, n - 9))
    if layout.has_bias:
        gyro = motion.C_lb / errors.gyro_gain.unsqueeze(-2)
        accel = motion.C_lb / errors.accel_gain.unsqueeze(-2)
        F[..., 6:9, 9:12] = -gyro
        F[..., 3:6, 12:15] = -accel
        if layout.has_scale:
            F[..., 6:9, 15:18] = -gyro * motion.omega_ib_b.unsqueeze(-2)
            F[..., 3:6, 18:21] = -accel * motion.f_b.unsqueeze(-2)
        F.diagonal(dim1=-2, dim2=-1)[..., 9:15] = -1.0 / tau
    return F


def gravity_gradient(lat: Tensor, height: Tensor) -> Tensor:
    """Return by how much less a car falls per metre of height: −∂γ/∂h ≈ 2γ/a.

    The derivative of the free-air term of [NGA2014] Eq. (4-3).

    Args:
        lat: Geodetic latitude, rad, shape (...).
        height: Height above the ellipsoid, m, shape (...).

    Returns:
        Gradient, 1/s², positive, shape (...).
    """
    bulge = 1.0 + wgs84.FLATTENING + wgs84.GRAVITY_RATIO
    slope = bulge - 2.0 * wgs84.FLATTENING * torch.sin(lat) ** 2
    surface = earth.normal_gravity(lat, torch.zeros_like(height))
    return 2.0 * surface / wgs84.SEMI_MAJOR_AXIS * (slope - 3.0 * height / wgs84.SEMI_MAJOR_AXIS)


def _matrix(rows: tuple[tuple[Tensor, ...], ...]) -> Tensor:
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def _blocks(rows: tuple[tuple[Tensor, ...], ...]) -> Tensor:
    return torch.cat([torch.cat(row, -1) for row in rows], -2)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
