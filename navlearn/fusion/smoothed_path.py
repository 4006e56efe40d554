"""The full-rate path of a smoothed drive, without jumps where blocks meet.

Each block is mechanized anew from its smoothed start with its smoothed sensor parameters. What is
then left to its smoothed end is the noise that the smoother found in the block; it is laid over
the time in which the car moved.
"""

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.fusion.block_motion import move_block
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.record import path_in_blocks, starts_of_blocks
from navlearn.fusion.shen_transition import move_offset
from navlearn.fusion.timeline import Timeline, trajectory_of_blocks
from navlearn.states import NavState, RissSample, Trajectory


def smoothed_path(model: FilterModel, start: Belief, after: Belief, line: Timeline) -> Trajectory:
    """Return the path between smoothed beliefs.

    Velocity is what odometer and azimuth say, both smoothed: turned by what the azimuth was moved
    inside the block, not the slope of what the position was.

    Args:
        model: The filter.
        start: Smoothed belief before the first block, batch shape (B,).
        after: Smoothed belief at the end of each block, batch shape (B, K).
        line: The drives in blocks.

    Returns:
        Trajectory, shape (B, T) each.
    """
    path = path_in_blocks(model, start, after, line)
    done, half = _share_done(line.samples)
    ends = NavState(*(channel[..., -1:] for channel in path[:4]))
    jump = NavState(*(a.unsqueeze(-1) - b for a, b in zip(after.state, ends, strict=True)))
    state = NavState(*(x + done * step for x, step in zip(path[:4], jump, strict=True)))
    turned = half * jump.azimuth
    sine, cosine = torch.sin(turned), torch.cos(turned)
    v_e, v_n = path.v_e * cosine + path.v_n * sine, path.v_n * cosine - path.v_e * sine
    v_u = path.v_u
    if model.layout.has_velocity:
        v = torch.stack((v_e, v_n, v_u), -1)
        v = v + half.unsqueeze(-1) * _offset_jump(model, start, after, line).unsqueeze(-2)
        v_e, v_n, v_u = v.unbind(-1)
    return trajectory_of_blocks(line, Trajectory(*state, v_e, v_n, v_u), after.state)


def _share_done(samples: RissSample) -> tuple[Tensor, Tensor]:
    """Return the share of a block's moving time at the end and the middle of each interval."""
    # a block all at rest is cut by time, one of no length is done at once
    weight = samples.dt * (1.0 - samples.stationary) + 1e-9 * samples.dt
    total = weight.sum(-1, keepdim=True)
    share = weight / torch.where(total > 0.0, total, 1.0)
    done = torch.cumsum(share, -1)
    return torch.where(total > 0.0, done, 1.0), done - 0.5 * share


def _offset_jump(model: FilterModel, start: Belief, after: Belief, line: Timeline) -> Tensor:
    begin = starts_of_blocks(start, after)
    moved = move_block(
        model.errors,
        begin.state,
        begin.sensor,
        begin.anchor,
        line.samples,
        line.acceleration,
        model.earth_rate,
    )
    ahead = move_offset(model.errors, moved, line.samples, begin.sensor, begin.velocity_offset)
    return after.velocity_offset - ahead.offset
