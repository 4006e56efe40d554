"""The velocity of the rear axle in the car's axes: what odometer and axle constrain."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import matrix_from_angles
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.moment import Moment, columns, skew_of


class AxleVelocity(NamedTuple):
    """Velocity of the rear axle's middle, right, forward, up in the car's axes.

    Attributes:
        velocity: m/s, shape (..., 3).
        by_error: Its derivative per error state, shape (..., 3, n).
    """

    velocity: Tensor
    by_error: Tensor


def axle_velocity(
    model: InsFilterModel, belief: InsBelief, now: Moment, earlier: Tensor
) -> AxleVelocity:
    """Return the velocity of the rear axle.

    [Groves2013] Eq. (15.13): C_vb (C_bl v_l + ω × l), with C_vb of the mounting angles.

    Args:
        model: The filter.
        belief: Belief, batch shape (...).
        now: The car at that time.
        earlier: By how much earlier the velocity is wanted, s, shape (...): a mean over the last
            interval is that of its middle.

    Returns:
        Velocity and derivative.
    """
    back = earlier.unsqueeze(-1)
    v_l = belief.state.v_l - back * now.a_l
    wide = back.unsqueeze(-1)
    arm = now.arm(model.options.wheel_lever_arm)
    angles = torch.tensor(model.options.mounting, dtype=arm.dtype, device=arm.device)
    C_vb = matrix_from_angles(*angles.unbind(0))
    C_vl = C_vb @ now.C_lb.transpose(-1, -2)
    around = torch.linalg.cross(now.omega_ib_b, arm.expand_as(now.omega_ib_b), dim=-1)
    velocity = C_vl @ v_l.unsqueeze(-1) + C_vb @ around.unsqueeze(-1)
    by_error = columns(
        model.layout,
        now,
        velocity=C_vl,
        attitude=C_vl @ (skew_of(v_l) + wide * skew_of(now.f_l)),
        omega=-C_vb @ skew_of(arm).expand(*v_l.shape, 3),
        force=-wide * C_vb.expand(*v_l.shape, 3),
    )
    return AxleVelocity(velocity.squeeze(-1), by_error)
