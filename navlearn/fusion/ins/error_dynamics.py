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
from navlearn.fusion.ins.imu_errors import ImuErrors, SensorStates
from navlearn.mechanization.preintegration_sums import skew
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
    """Return the motion in the middle of an interval; scriptable.

    Args:
        before: State at its start, batch shape (...).
        after: State at its end, batch shape (...).
        omega: Mean angular rate, sensor errors removed, rad/s, shape (..., 3).
        force: Mean specific force, sensor errors removed, m/s², shape (..., 3).

    Returns:
        Motion.
    """
    # q and −q are one attitude
    along = (before.q_lb * after.q_lb).sum(-1, keepdim=True)
    middle = torch.where(along < 0.0, before.q_lb - after.q_lb, before.q_lb + after.q_lb)
    length = torch.sqrt((middle * middle).sum(-1, keepdim=True))
    C_lb = matrix_from_quaternion(middle / length)
    return Motion(
        0.5 * (before.lat + after.lat),
        0.5 * (before.height + after.height),
        0.5 * (before.v_l + after.v_l),
        C_lb,
        omega,
        force,
    )


def phi_angle_dynamics(motion: Motion) -> Tensor:
    """Return F of position, velocity and attitude errors in the complete φ-angle model; scriptable.

    Args:
        motion: Motion, batch shape (...).

    Returns:
        F, 1/s, shape (..., 9, 9).
    """
    r_m = earth.meridian_radius(motion.lat) + motion.height
    r_n = earth.prime_vertical_radius(motion.lat) + motion.height
    tan = torch.tan(motion.lat)
    v_e, v_n, v_u = motion.v_l.unbind(-1)
    zero = torch.zeros_like(tan)
    rate_ie = earth.earth_rate_enu(motion.lat)
    rate_el = torch.stack((-v_n / r_m, v_e / r_n, v_e * tan / r_n), -1)
    # δω_el by velocity errors, δω_el and δω_ie by position errors
    by_velocity = _matrix(
        [[zero, -1.0 / r_m, zero], [1.0 / r_n, zero, zero], [tan / r_n, zero, zero]]
    )
    bend = v_e * (1.0 + tan * tan) / (r_n * r_m)
    of_level = _matrix(
        [
            [zero, zero, v_n / (r_m * r_m)],
            [zero, zero, -v_e / (r_n * r_n)],
            [zero, bend, -v_e * tan / (r_n * r_n)],
        ]
    )
    of_earth = _matrix(
        [
            [zero, zero, zero],
            [zero, -rate_ie[..., 2] / r_m, zero],
            [zero, rate_ie[..., 1] / r_m, zero],
        ]
    )
    fall = gravity_gradient(motion.lat, motion.height)
    gravity = torch.diag_embed(torch.stack((zero, zero, fall), -1))
    across = skew(motion.v_l)
    metres = _matrix(
        [
            [v_u / r_n - v_n * tan / r_m, v_e * tan / r_m, -v_e / r_n],
            [zero, v_u / r_m, -v_n / r_m],
            [zero, zero, zero],
        ]
    )
    eye = torch.eye(3, dtype=tan.dtype, device=tan.device).expand_as(metres)
    force = (motion.C_lb @ motion.f_b.unsqueeze(-1)).squeeze(-1)
    top = torch.cat((metres, eye, torch.zeros_like(metres)), -1)
    pushed = across @ (2.0 * of_earth + of_level) + gravity
    turned = across @ by_velocity - skew(2.0 * rate_ie + rate_el)
    middle = torch.cat((pushed, turned, -skew(force)), -1)
    low = torch.cat((-of_earth - of_level, -by_velocity, -skew(rate_ie + rate_el)), -1)
    return torch.cat((top, middle, low), -2)


def with_sensors(
    core: Tensor, motion: Motion, errors: ImuErrors, has: SensorStates, tau: float
) -> Tensor:
    """Return F of navigation and sensor errors from that of navigation errors; scriptable.

    Too large a bias or scale makes the corrected rate and force too small, hence the signs.

    Args:
        core: F of position, velocity and attitude errors, shape (..., 9, 9).
        motion: Motion, batch shape (...).
        errors: Sensor parameters, batch shape (...).
        has: Which sensor errors are states.
        tau: Correlation time of the biases, s; infinite for random walks.

    Returns:
        F, shape (..., n, n).
    """
    size = 12 * int(has.scale) + 6 * int(has.bias and not has.scale) + int(has.odometer_scale)
    F = torch.nn.functional.pad(core, [0, size, 0, size])
    if not has.bias:
        return F
    gyro = motion.C_lb / errors.gyro_gain.unsqueeze(-2)
    accel = motion.C_lb / errors.accel_gain.unsqueeze(-2)
    none = torch.zeros_like(gyro)
    in_velocity, in_attitude = [none, -accel], [-gyro, none]
    if has.scale:
        in_velocity += [none, -accel * motion.f_b.unsqueeze(-2)]
        in_attitude += [-gyro * motion.omega_ib_b.unsqueeze(-2), none]
    by_sensor = torch.cat((torch.cat(in_velocity, -1), torch.cat(in_attitude, -1)), -2)
    known = by_sensor.shape[-1]
    F = F + torch.nn.functional.pad(by_sensor, [9, size - known, 3, size])
    decay = torch.full_like(motion.v_l, -1.0 / tau)
    diagonal = torch.nn.functional.pad(torch.cat((decay, decay), -1), [9, size - 6])
    return F + torch.diag_embed(diagonal)


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


def _matrix(rows: list[list[Tensor]]) -> Tensor:
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
