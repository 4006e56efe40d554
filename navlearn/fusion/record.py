"""From the ends of blocks to a history: beliefs at block starts, and the path between."""

from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.block_motion import move_block
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.gating import Judged
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.shen_transition import move_offset
from navlearn.fusion.timeline import Timeline, trajectory_of_blocks
from navlearn.states import Trajectory

AnyBelief = TypeVar("AnyBelief", Belief, InsBelief)


class Ended(NamedTuple):
    """One block's end.

    Attributes:
        prior: Belief before the update.
        belief: Belief after it.
        innovation: Measured minus predicted, shape (B, r).
        judged: What the gate said.
        deviation: Estimate minus free mechanization, shape (B, n); zero in a closed loop.
    """

    prior: Belief
    belief: Belief
    innovation: Tensor
    judged: Judged
    deviation: Tensor


def history(
    line: Timeline, record: Ended, path: Trajectory, method: str, passes: int
) -> FilterHistory:
    """Return the history of a run.

    Args:
        line: The drives in blocks.
        record: Every block's end, batch shape (B, K).
        path: Prediction inside blocks, shape (B, K, n) each.
        method: Form that computed it.
        passes: Passes it took.

    Returns:
        History.
    """
    resets = (record.judged.verdict == int(Verdict.ACCEPTED_BY_RESET)).sum(1)
    return FilterHistory(
        line.blocks.end,
        line.blocks.fix,
        record.prior,
        record.belief,
        trajectory_of_blocks(line, path, record.belief.state),
        record.innovation,
        record.judged.nis,
        record.judged.verdict,
        resets,
        -record.deviation,
        method,
        passes,
    )


def starts_of_blocks(start: AnyBelief, after: AnyBelief) -> AnyBelief:
    """Return the beliefs with which blocks start, from those with which they ended.

    Args:
        start: Belief before the first block, batch shape (B,).
        after: Belief after each block, batch shape (B, K).

    Returns:
        Beliefs, batch shape (B, K).
    """

    def shift(first: Tensor, rest: Tensor) -> Tensor:
        return torch.cat((first.unsqueeze(1), rest[:, :-1]), 1)

    pairs = zip(start.state, after.state, strict=True)
    state = type(start.state)(*(shift(a, b) for a, b in pairs))
    others = (shift(a, b) for a, b in zip(start[1:], after[1:], strict=True))
    return type(start)(state, *others)


def path_in_blocks(model: FilterModel, start: Belief, after: Belief, line: Timeline) -> Trajectory:
    """Return the predicted path inside all blocks, mechanized from the beliefs at their starts.

    Args:
        model: The filter.
        start: Belief before the first block, batch shape (B,).
        after: Belief after each block, batch shape (B, K).
        line: The drives in blocks.

    Returns:
        Trajectory, shape (B, K, n) each.
    """
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
    east, north, up = (torch.cumsum(way, -1) for way in (moved.east, moved.north, moved.up))
    motion = moved.motion
    v_e, v_n, v_u = motion.v_h * moved.sine, motion.v_h * moved.cosine, motion.v_u
    if model.layout.has_velocity:
        offset = move_offset(model.errors, moved, line.samples, begin.sensor, begin.velocity_offset)
        more, extra = offset.way.unbind(-1), offset.velocity.unbind(-1)
        east, north, up = east + more[0], north + more[1], up + more[2]
        v_e, v_n, v_u = v_e + extra[0], v_n + extra[1], v_u + extra[2]
    state = begin.state
    return Trajectory(
        state.lat.unsqueeze(-1) + north * moved.per_lat.unsqueeze(-1),
        state.lon.unsqueeze(-1) + east * moved.per_lon.unsqueeze(-1),
        state.height.unsqueeze(-1) + up,
        state.azimuth.unsqueeze(-1) + torch.cumsum(moved.turn, -1),
        v_e,
        v_n,
        v_u,
    )
