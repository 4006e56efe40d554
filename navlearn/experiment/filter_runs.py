"""Filter runs over known logs, made once and shared by the methods.

The known logs of a drive's outages begin alike. A run over the next one goes on from the belief
at the last fix up to which both are the same, sample by sample; no run sees anything but the log
that it was asked for.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.continued import continued
from navlearn.logs.resample import RissTimeline
from navlearn.navigator import Navigator, NavigatorRun
from navlearn.states import FixTiming, GnssFix, RissSample


class MadeRun(NamedTuple):
    """A filter's run over one log.

    Attributes:
        timeline: The log as tensors.
        navigator: What ran.
        run: The run.
    """

    timeline: RissTimeline
    navigator: Navigator
    run: NavigatorRun


def made_run(navigator: Navigator, timeline: RissTimeline, earlier: MadeRun | None) -> MadeRun:
    """Return a filter's run over a log, continued from an earlier one where that is the same.

    Args:
        navigator: What runs.
        timeline: The log as tensors.
        earlier: A run of a navigator with the same options over another log, or None.
    """
    block = None if earlier is None else last_block_in_common(earlier, timeline)
    if earlier is None or block is None:
        run = navigator.run(timeline.samples, timeline.fixes, timeline.timing)
        return MadeRun(timeline, navigator, run)
    first = earlier.run.first
    rest = RissSample(*(channel[first:] for channel in timeline.samples))
    later = timeline.timing.index >= first
    history = continued(
        navigator.filter,
        earlier.run.history,
        block,
        rest,
        GnssFix(*(channel[later] for channel in timeline.fixes)),
        FixTiming(timeline.timing.index[later] - first, timeline.timing.delay[later]),
    )
    run = NavigatorRun(first, earlier.run.alignment, rest, history)
    return MadeRun(timeline, navigator, run)


def last_block_in_common(earlier: MadeRun, timeline: RissTimeline) -> int | None:
    """Return the last block of a run that ends with a fix and is the same in another log.

    Args:
        earlier: The run.
        timeline: The other log as tensors.

    Returns:
        The block's index, or None where the logs do not begin alike.
    """
    run, old = earlier.run, earlier.timeline
    if earlier.navigator.options.method != "fast" or not earlier.navigator.filter.model.closed:
        return None
    samples = _same(old.samples, timeline.samples) - run.first
    fixes = _same((*old.fixes, *old.timing), (*timeline.fixes, *timeline.timing))
    # the first fix that differs may fall before the end of what samples have in common
    differs = [one[fixes : fixes + 1] for one in (old.timing.index, timeline.timing.index)]
    until = min([samples, *(int(index) - run.first for index in torch.cat(differs))])
    before = int((old.timing.index < run.first).sum())
    end, fix = run.history.end, run.history.fix
    alone = torch.ones_like(fix, dtype=torch.bool)
    alone[:-1] = end[1:] != end[:-1]
    usable = torch.nonzero((fix >= 0) & alone & (end < until) & (fix + before < fixes))
    return int(usable[-1]) if len(usable) else None


def _same(old: tuple[Tensor, ...], new: tuple[Tensor, ...]) -> int:
    """Return up to which index channels of two records are the same, to the last bit."""
    length = min(old[0].shape[0], new[0].shape[0])
    differ = torch.zeros(length, dtype=torch.bool)
    for a, b in zip(old, new, strict=True):
        differ |= a[:length] != b[:length]
    found = torch.nonzero(differ)
    return int(found[0]) if len(found) else length
