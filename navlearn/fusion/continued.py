"""A filter's run continued from one of its own beliefs, where a drive has grown.

Blocks end at fixes, and what a block takes from samples lies in it or before it: the blocks after
a fix, run from the belief at that fix, are those of a run over the whole drive.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import torch
from torch import Tensor

from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.batch_axis import unsqueezed
from navlearn.fusion.blocks import Blocks
from navlearn.fusion.checks import check_history
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.timeline import Timeline, timeline
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, Trajectory

N = TypeVar("N")


def continued(
    ekf: LooselyCoupledEkf | LooselyCoupledUkf,
    earlier: FilterHistory,
    block: int,
    samples: RissSample,
    fixes: GnssFix,
    timing: FixTiming,
) -> FilterHistory:
    """Return the run over a drive that begins like the one of an earlier run.

    Args:
        ekf: The filter, with closed feedback.
        earlier: Its run, no batch axis; gradients are not carried on.
        block: Up to the end of this block of the earlier run both drives are the same. It ends
            with a fix, and no other block ends at the same sample.
        samples: Samples of the whole drive, shape (T,) each.
        fixes: Its fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.

    Returns:
        History of the whole drive, no batch axis, as the fast form gives it.

    Raises:
        FilterDivergedError: If a state or variance is lost on the way.
    """
    whole = timeline(
        ekf.model,
        _each(samples, unsqueezed),
        _each(fixes, unsqueezed),
        _each(timing, unsqueezed),
    )
    done, gone = block + 1, int(earlier.end[block]) + 1
    line = _after(whole, done, gone)
    start = map_belief(earlier.belief, lambda channel: channel[block : block + 1])
    with torch.no_grad():
        later = ekf.over(start, line, "fast")
    joined = _joined(earlier, later, done, gone)
    check_history(ekf.model, _each(joined, unsqueezed), _each(samples, unsqueezed))
    return joined


def _after(line: Timeline, done: int, gone: int) -> Timeline:
    """Return a timeline without its first blocks and samples."""
    old = line.blocks
    width = old.gather.shape[-1]
    blocks = Blocks(
        gather=(old.gather[:, done:] - gone).clamp(min=0),
        used=old.used[:, done:],
        end=old.end[:, done:] - gone,
        closes=old.closes[:, done:],
        fix=old.fix[:, done:],
        place=old.place[:, gone:] - done * width,
        even=old.even,
    )

    def cut(channel: Tensor) -> Tensor:
        return channel[:, done:]

    return Timeline(
        blocks, _each(line.samples, cut), cut(line.acceleration), _each(line.occasion, cut)
    )


def _joined(earlier: FilterHistory, later: FilterHistory, done: int, gone: int) -> FilterHistory:
    def blocks(old: Tensor, new: Tensor) -> Tensor:
        return torch.cat((old[:done], new[0]))

    def beliefs(old: Belief, new: Belief) -> Belief:
        state = NavState(*(blocks(a, b) for a, b in zip(old.state, new.state, strict=True)))
        return Belief(state, *(blocks(a, b) for a, b in zip(old[1:], new[1:], strict=True)))

    old_path, new_path = earlier.trajectory, later.trajectory
    path = (torch.cat((a[:gone], b[0])) for a, b in zip(old_path, new_path, strict=True))
    verdict = blocks(earlier.verdict, later.verdict)
    return FilterHistory(
        end=torch.cat((earlier.end[:done], later.end[0] + gone)),
        fix=blocks(earlier.fix, later.fix),
        prior=beliefs(earlier.prior, later.prior),
        belief=beliefs(earlier.belief, later.belief),
        trajectory=Trajectory(*path),
        innovation=blocks(earlier.innovation, later.innovation),
        nis=blocks(earlier.nis, later.nis),
        verdict=verdict,
        resets=(verdict == int(Verdict.ACCEPTED_BY_RESET)).sum(0),
        error=blocks(earlier.error, later.error),
        method=later.method if earlier.method == later.method else "exact",
        passes=max(earlier.passes, later.passes),
    )


def _each(tree: N, change: Callable[[Tensor], Tensor]) -> N:
    """Return a tree of named tuples with a function applied to every tensor in it."""
    branches: Any = tree
    if isinstance(branches, Tensor):
        return change(branches)  # type: ignore[return-value]
    if isinstance(branches, tuple):
        return type(tree)(*(_each(branch, change) for branch in branches))
    return tree
