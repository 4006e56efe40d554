"""Smoothing a full-IMU drive: what its filter would have believed, had it known what was to come.

Rauch–Tung–Striebel over the filter's own blocks [Rauch1965], as
:mod:`navlearn.fusion.smoothing` does it for the RISS filter: one pass about the filter's own
beliefs is the classical smoother, passes about what was smoothed before are the iterated one
[Bell1994]. What the gate refused stays refused, and where it reset, the covariance that it opened
is process noise.
"""

from functools import partial
from typing import NamedTuple

from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.filters.tight_belief import map_tree
from navlearn.fusion.batch_axis import first, unsqueezed
from navlearn.fusion.ins.fast import largest_move
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.smoothed_path import ins_smoothed_path
from navlearn.fusion.ins.smoothing_pass import ins_evidence_of, ins_smoothing_pass
from navlearn.fusion.ins.timeline import ins_timeline
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.smoothed_blocks import SmoothingOptions, iterated
from navlearn.fusion.unscented.ins import InsUkf
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState


class SmoothedInsDrive(NamedTuple):
    """A smoothed drive; K counts blocks.

    Attributes:
        end: Last sample of each block, int64, shape (B, K).
        start: Belief before the first sample, batch shape (B,).
        belief: Belief at the end of each block, batch shape (B, K).
        trajectory: Solution at full rate, without jumps, batch shape (B, T).
        transition: Φ of each block, shape (B, K, n, n).
        gain: Smoother gain from each block's end to its start, shape (B, K, n, n).
        passes: Passes it took.
    """

    end: Tensor
    start: InsBelief
    belief: InsBelief
    trajectory: InsState
    transition: Tensor
    gain: Tensor
    passes: int


def smooth_ins(
    ekf: InsEkf | InsUkf,
    start: InsBelief,
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    history: InsHistory,
    options: SmoothingOptions | None = None,
) -> SmoothedInsDrive:
    """Smooth what a full-IMU filter made of drives.

    Args:
        ekf: The filter; an unscented one is smoothed as an extended one, from its own beliefs.
        start: Belief with which it started, batch shape (B,) or ().
        samples: Its samples, shape (B, T) or (T,) each, vectors (B, T, 3) or (T, 3).
        fixes: Its fixes, shape (B, M) or (M,) each.
        timing: Where they fall among the samples.
        history: What it made of them; its verdicts are kept.
        options: Passes; None means the defaults.

    Returns:
        Smoothed drives; without batch axis where the input had none.

    Raises:
        ShapeError: The history is not that of these samples and fixes.
    """
    if samples.dt.dim() == 1:
        batched = smooth_ins(
            ekf,
            map_ins_belief(start, unsqueezed),
            ImuSample(*map(unsqueezed, samples)),
            GnssFix(*map(unsqueezed, fixes)),
            FixTiming(*map(unsqueezed, timing)),
            map_tree(history, unsqueezed),
            options,
        )
        alone: SmoothedInsDrive = map_tree(batched, first)
        return alone
    model = ekf.model
    line = ins_timeline(model, samples, fixes, timing)
    if history.end.shape != line.blocks.end.shape or bool((history.end != line.blocks.end).any()):
        raise ShapeError(
            f"smoothing: the history has {history.end.shape[-1]} blocks that end elsewhere than "
            f"the {line.blocks.end.shape[-1]} of these samples and fixes; pass what the filter ran "
            "on, and the filter itself"
        )
    evidence = ins_evidence_of(model, start, line, history, ekf.noise)
    begin = starts_of_blocks(start, history.belief)
    run = partial(ins_smoothing_pass, model, evidence)
    found, passes = iterated(begin, run, largest_move, options or SmoothingOptions())
    return SmoothedInsDrive(
        line.blocks.end,
        found.start,
        found.belief,
        ins_smoothed_path(model, found.start, found.belief, line),
        found.transition,
        found.gain,
        passes,
    )
