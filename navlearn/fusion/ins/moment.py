"""The car at the end of a block as measurements see it, and how they depend on the errors."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import matrix_from_quaternion
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.imu_errors import ImuErrors, imu_corrected
from navlearn.fusion.ins.layout import InsLayout, imu_errors
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.mechanization.preintegration_sums import skew as skew_of
from navlearn.states import ImuSample

__all__ = ["Moment", "columns", "moment_of", "skew_of"]


class Moment(NamedTuple):
    """Attitude, rate and force at one time, sensor errors removed, batch shape (...).

    Attributes:
        C_lb: Body to local level, shape (..., 3, 3).
        omega_ib_b: Angular rate, rad/s, shape (..., 3).
        f_b: Specific force, m/s², shape (..., 3).
        f_l: The same in the local level, shape (..., 3).
        a_l: Acceleration against the Earth (Coriolis left out), m/s², shape (..., 3).
        errors: Sensor parameters.
    """

    C_lb: Tensor
    omega_ib_b: Tensor
    f_b: Tensor
    f_l: Tensor
    a_l: Tensor
    errors: ImuErrors

    def arm(self, lever_arm: tuple[float, float, float]) -> Tensor:
        """Return a lever arm as a tensor in the body, m, shape (3,)."""
        return torch.tensor(lever_arm, dtype=self.f_b.dtype, device=self.f_b.device)

    def level(self, lever_arm: tuple[float, float, float]) -> Tensor:
        """Return a lever arm in the local level, m, shape (..., 3)."""
        turned = torch.matmul(self.C_lb, self.arm(lever_arm))
        return turned

    def swung(self, lever_arm: tuple[float, float, float]) -> Tensor:
        """Return how fast the end of a lever arm moves around the IMU, ENU, m/s, shape (..., 3)."""
        arm = self.arm(lever_arm).expand_as(self.omega_ib_b)
        around: Tensor = torch.linalg.cross(self.omega_ib_b, arm, dim=-1)
        return (self.C_lb @ around.unsqueeze(-1)).squeeze(-1)


def moment_of(model: InsFilterModel, belief: InsBelief, last: ImuSample) -> Moment:
    """Return the car as a belief and the last sample have it.

    Args:
        model: The filter.
        belief: Belief, batch shape (...).
        last: Last sample, shape (...) each.

    Returns:
        Moment.
    """
    errors = imu_errors(model.layout, belief.sensor)
    omega, force = imu_corrected(errors, last.omega_ib_b, last.f_b)
    C_lb = matrix_from_quaternion(belief.state.q_lb)
    f_l = (C_lb @ force.unsqueeze(-1)).squeeze(-1)
    gravity = earth.normal_gravity(belief.state.lat, belief.state.height)
    a_l = torch.cat((f_l[..., :2], f_l[..., 2:] - gravity.unsqueeze(-1)), -1)
    return Moment(C_lb, omega, force, f_l, a_l, errors)


def columns(
    layout: InsLayout,
    now: Moment,
    *,
    position: Tensor | None = None,
    velocity: Tensor | None = None,
    attitude: Tensor | None = None,
    omega: Tensor | None = None,
    force: Tensor | None = None,
    gyro_bias: Tensor | None = None,
    gyro_scale: Tensor | None = None,
) -> Tensor:
    """Return H of a prediction from its derivatives by what it is made of.

    Args:
        layout: Order of the error states.
        now: The car.
        position: By position, shape (..., r, 3); None means zero, here and below.
        velocity: By velocity, shape (..., r, 3).
        attitude: By the small rotation φ, shape (..., r, 3).
        omega: By the corrected angular rate, shape (..., r, 3): through gyro bias and scale.
        force: By the corrected specific force, shape (..., r, 3): through the accelerometers'.
        gyro_bias: By the gyro bias itself, shape (..., r, 3).
        gyro_scale: By the gyro scale error itself, shape (..., r, 3).

    Returns:
        H, shape (..., r, n).
    """
    given = (position, velocity, attitude, omega, force, gyro_bias, gyro_scale)
    shape = next(x.shape for x in given if x is not None)
    zero = now.f_l.new_zeros(shape)

    def or_zero(block: Tensor | None) -> Tensor:
        return zero if block is None else block

    parts = [or_zero(position), or_zero(velocity), or_zero(attitude)]
    by_gyro = -or_zero(omega) / now.errors.gyro_gain.unsqueeze(-2)
    by_accel = -or_zero(force) / now.errors.accel_gain.unsqueeze(-2)
    if layout.has_bias:
        parts += [by_gyro + or_zero(gyro_bias), by_accel]
    if layout.has_scale:
        scaled = by_gyro * now.omega_ib_b.unsqueeze(-2) + or_zero(gyro_scale)
        parts += [scaled, by_accel * now.f_b.unsqueeze(-2)]
    if layout.odometer_scale:
        parts.append(zero[..., :1])
    return torch.cat(parts, -1)
