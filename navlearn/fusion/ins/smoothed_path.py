"""The full-rate path of a smoothed full-IMU drive, without jumps where blocks meet.

Each block is mechanized anew from its smoothed start with its smoothed sensor parameters. What is
then left to its smoothed end is the white noise that the smoother found in the block. Given both
ends, the mean of twice integrated white noise is a cubic in time, so that velocity stays the
slope of position; that of once integrated noise, the attitude, is a straight line.
"""

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.layout import moved_state, state_difference
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.path import ins_path_in_blocks
from navlearn.fusion.ins.timeline import InsTimeline, ins_trajectory
from navlearn.states import InsState


def ins_smoothed_path(
    model: InsFilterModel, start: InsBelief, after: InsBelief, line: InsTimeline
) -> InsState:
    """Return the path between smoothed beliefs.

    Args:
        model: The filter.
        start: Smoothed belief before the first block, batch shape (B,).
        after: Smoothed belief at the end of each block, batch shape (B, K).
        line: The drives in blocks.

    Returns:
        Trajectory, batch shape (B, T).
    """
    path = ins_path_in_blocks(model, start, after, line)
    ends = InsState(*(channel[:, :, -1] for channel in path))
    left = state_difference(after.state, ends)
    inside = moved_state(path, spread_over(left, line.samples.dt))
    return ins_trajectory(line, inside, after.state)


def spread_over(left: Tensor, dt: Tensor) -> Tensor:
    """Return what is to be added inside blocks so that they end where they should.

    Args:
        left: Position (m), velocity (m/s) and rotation (rad) missing at each end, shape (..., 9).
        dt: Lengths of intervals, s; zero pads, shape (..., n).

    Returns:
        Additions at the end of every interval, shape (..., n, 9).
    """
    total = dt.sum(-1, keepdim=True)
    # a block of no length is at its end at once
    share = torch.where(
        total > 0.0, torch.cumsum(dt, -1) / torch.where(total > 0.0, total, 1.0), 1.0
    )
    s, T = share.unsqueeze(-1), total.unsqueeze(-1)
    way, speed, turn = torch.split(left.unsqueeze(-2), 3, -1)
    bend = s * s * (3.0 - 2.0 * s)
    slope = torch.where(T > 0.0, 6.0 * s * (1.0 - s) / torch.where(T > 0.0, T, 1.0), 0.0)
    moved = bend * way + T * s * s * (s - 1.0) * speed
    return torch.cat((moved, slope * way + s * (3.0 * s - 2.0) * speed, s * turn), -1)
