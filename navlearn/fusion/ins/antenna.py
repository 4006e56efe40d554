"""Where the GNSS antenna of a full-IMU car is against the IMU, and how fast it moves.

[Groves2013] §14.3.1, turned to ENU and RFU. Fixes and single ranges see the same antenna; both are
measured against this.
"""

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.antenna import AntennaMotion
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.moment import Moment, columns, skew_of


def ins_antenna_offset(
    model: InsFilterModel, belief: InsBelief, now: Moment, lag: Tensor
) -> AntennaMotion:
    """Return where the antenna was a moment before the end of a block, from the IMU at the end.

    Args:
        model: The filter.
        belief: Belief at the end, batch shape (...).
        now: The car at the end.
        lag: How long before the end, s, shape (...).

    Returns:
        Offset and derivative.
    """
    lag = lag.unsqueeze(-1)
    arm = now.level(model.options.lever_arm)
    swing = now.swung(model.options.lever_arm)
    # at that time the car was where its velocity half-way took it from
    back = belief.state.v_l + swing - 0.5 * lag * now.a_l
    wide = lag.unsqueeze(-1)
    eye = torch.eye(3, dtype=lag.dtype, device=lag.device).expand(*lag.shape[:-1], 3, 3)
    by_error = columns(
        model.layout,
        now,
        position=eye,
        velocity=-wide * eye,
        attitude=-skew_of(arm) + wide * skew_of(swing) - 0.5 * wide * wide * skew_of(now.f_l),
        omega=wide * now.C_lb @ skew_of(now.arm(model.options.lever_arm)),
        force=0.5 * wide * wide * now.C_lb,
    )
    return AntennaMotion(arm - lag * back, by_error)


def ins_antenna_velocity(
    model: InsFilterModel, belief: InsBelief, now: Moment, lag: Tensor
) -> AntennaMotion:
    """Return the velocity of the antenna a moment before the end of a block.

    Args:
        model: The filter.
        belief: Belief at the end, batch shape (...).
        now: The car at the end.
        lag: How long before the end, s, shape (...).

    Returns:
        Velocity against the Earth and its derivative.
    """
    lag = lag.unsqueeze(-1)
    swing = now.swung(model.options.lever_arm)
    wide = lag.unsqueeze(-1)
    eye = torch.eye(3, dtype=lag.dtype, device=lag.device).expand(*lag.shape[:-1], 3, 3)
    by_error = columns(
        model.layout,
        now,
        velocity=eye,
        attitude=-skew_of(swing) + wide * skew_of(now.f_l),
        omega=-now.C_lb @ skew_of(now.arm(model.options.lever_arm)),
        force=-wide * now.C_lb,
    )
    return AntennaMotion(belief.state.v_l + swing - lag * now.a_l, by_error)
