"""Smoothing a drive: what the filter would have believed, had it known the fixes to come.

Rauch–Tung–Striebel over the filter's own blocks [Rauch1965]: deviations from what each block
predicts are filtered and smoothed as a linear system. One pass about the filter's own beliefs is
the classical smoother; passes about what was smoothed before are the iterated one, which is
Gauss–Newton on the whole drive [Bell1994], and which a drift of some degrees needs. What the
gate refused stays refused, and where it reset nothing is known across: the covariance opened
there is process noise.
"""

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.filters.belief import Belief, map_belief
from navlearn.filters.tight_belief import map_tree
from navlearn.fusion.batch_axis import first, unsqueezed
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.smoothed_blocks import SmoothingOptions as SmoothingOptions
from navlearn.fusion.smoothed_blocks import iterated
from navlearn.fusion.smoothed_path import smoothed_path
from navlearn.fusion.smoothing_pass import evidence_of, smoothing_pass
from navlearn.fusion.timeline import timeline
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory


class SmoothedDrive(NamedTuple):
    """A smoothed drive; K counts blocks.

    Attributes:
        end: Last sample of each block, int64, shape (B, K).
        start: Belief before the first sample, batch shape (B,).
        belief: Belief at the end of each block, batch shape (B, K).
        trajectory: Solution at full rate, without jumps, shape (B, T) each.
        transition: Φ of each block, shape (B, K, n, n).
        gain: Smoother gain from each block's end to its start, shape (B, K, n, n).
        passes: Passes it took.
    """

    end: Tensor
    start: Belief
    belief: Belief
    trajectory: Trajectory
    transition: Tensor
    gain: Tensor
    passes: int


def smooth(
    ekf: LooselyCoupledEkf | LooselyCoupledUkf,
    start: Belief,
    samples: RissSample,
    fixes: GnssFix,
    timing: FixTiming,
    history: FilterHistory,
    options: SmoothingOptions | None = None,
) -> SmoothedDrive:
    """Smooth what a filter made of drives.

    Args:
        ekf: The filter.
        start: Belief with which it started, batch shape (B,) or ().
        samples: Its samples, shape (B, T) or (T,) each.
        fixes: Its fixes, shape (B, M) or (M,) each.
        timing: Where they fall among the samples.
        history: What it made of them; its verdicts are kept.
        options: Passes; None means the defaults. An unscented filter is smoothed in one pass, as
            its points see more than a derivative.

    Returns:
        Smoothed drives; without batch axis where the input had none.

    Raises:
        ShapeError: The history is not that of these samples and fixes.
    """
    if samples.dt.dim() == 1:
        batched = smooth(
            ekf,
            map_belief(start, unsqueezed),
            RissSample(*map(unsqueezed, samples)),
            GnssFix(*map(unsqueezed, fixes)),
            FixTiming(*map(unsqueezed, timing)),
            map_tree(history, unsqueezed),
            options,
        )
        alone: SmoothedDrive = map_tree(batched, first)
        return alone
    model = ekf.model
    line = timeline(model, samples, fixes, timing)
    if history.end.shape != line.blocks.end.shape or bool((history.end != line.blocks.end).any()):
        raise ShapeError(
            f"smoothing: the history has {history.end.shape[-1]} blocks that end elsewhere than "
            f"the {line.blocks.end.shape[-1]} of these samples and fixes; pass what the filter ran "
            "on, and the filter itself"
        )
    passes = 1
    if isinstance(ekf, LooselyCoupledUkf):
        found = ekf.smoothed(start, line, history)
    else:
        evidence = evidence_of(model, start, line, history, ekf.noise)
        begin = starts_of_blocks(start, history.belief)
        run = partial(smoothing_pass, model, evidence)
        found, passes = iterated(begin, run, _largest_move, options or SmoothingOptions())
    return SmoothedDrive(
        line.blocks.end,
        found.start,
        found.belief,
        smoothed_path(model, found.start, found.belief, line),
        found.transition,
        found.gain,
        passes,
    )


def _largest_move(new: Belief, old: Belief) -> float:
    move = torch.stack(
        [
            6.4e6 * (new.state.lat - old.state.lat).abs().amax(),
            6.4e6 * (new.state.lon - old.state.lon).abs().amax(),
            30.0 * (new.state.azimuth - old.state.azimuth).abs().amax(),
        ]
    )
    return float(move.detach().amax())
