"""A feed-forward filter from a moment of a run on.

The papers' filters let the mechanization run free and estimate its error beside it. Over a whole
drive a low-cost gyro leaves the range in which that error is linear; so the free mechanization
starts anew where a training window begins, from what the closed filter believes there.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import FitError
from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.navigator import NavigatorRun, belief_at
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, Trajectory

PADDING = 10
"""Most samples by which stretches that run as one batch may differ in length."""


class FeedForward(NamedTuple):
    """A feed-forward filter's run with fixes up to a moment and none from there on.

    Attributes:
        samples: Its intervals, shape (T,) each.
        fixes: Its fixes, shape (M,) each.
        timing: Where they fall among its intervals, shape (M,) each.
        history: What it believed.
        begin: Which interval of the closed run its first one is.
        gone: Which of its own intervals is the first without GNSS.
    """

    samples: RissSample
    fixes: GnssFix
    timing: FixTiming
    history: FilterHistory
    begin: int
    gone: int


def block_before(history: FilterHistory, sample: int) -> int:
    """Return the last block that ends before a sample.

    Args:
        history: History of one drive.
        sample: A sample.

    Raises:
        FitError: No block does.
    """
    found = torch.nonzero(history.end < sample)
    if len(found) == 0:
        raise FitError(
            "the filter's past is shorter than the training window; start the outages later or "
            "shorten window_s"
        )
    return int(found[-1])


class Stretch(NamedTuple):
    """What a feed-forward filter is to run over.

    Attributes:
        start: Where it starts.
        samples: Intervals, shape (T,) each.
        fixes: Fixes up to where GNSS is gone, shape (M,) each.
        timing: Where they fall among the intervals, shape (M,) each.
        begin: Which interval of the closed run the first one is.
        gone: Which of the intervals is the first without GNSS.
    """

    start: Belief
    samples: RissSample
    fixes: GnssFix
    timing: FixTiming
    begin: int
    gone: int


def stretch_of(
    closed: NavigatorRun, fixes: GnssFix, timing: FixTiming, span: tuple[int, int, int]
) -> Stretch:
    """Return what a feed-forward filter needs to run over a span of a drive.

    Args:
        closed: A run with feedback, which tells where to start.
        fixes: Fixes of the drive, shape (M,) each.
        timing: Where they fall among the intervals of the closed run, shape (M,) each.
        span: Where it begins, the first interval without GNSS, and the interval after the last
            one, as numbers of the closed run's intervals.

    Returns:
        A stretch that begins after the last block of the closed run before the span.

    Raises:
        FitError: The closed run has no block before the span.
    """
    begin, gone, stop = span
    block = block_before(closed.history, begin)
    first = int(closed.history.end[block]) + 1
    within = (timing.index >= first) & (timing.index < gone)
    return Stretch(
        belief_at(closed.history, block),
        RissSample(*(channel[first:stop] for channel in closed.samples)),
        GnssFix(*(channel[within] for channel in fixes)),
        FixTiming(timing.index[within] - first, timing.delay[within]),
        first,
        gone - first,
    )


def run_feed_forward(ekf: LooselyCoupledEkf, stretches: list[Stretch]) -> list[FeedForward]:
    """Run a feed-forward filter over stretches of one or several drives, those alike at once.

    Args:
        ekf: The filter, of the same error state as that of the closed runs.
        stretches: What to run over.

    Returns:
        A run per stretch.
    """
    made: dict[int, FeedForward] = {}
    for places in _of_like_length([len(one.samples.dt) for one in stretches]):
        runs = _run_together(ekf, [stretches[k] for k in places])
        made |= dict(zip(places, runs, strict=True))
    return [made[k] for k in range(len(stretches))]


def _of_like_length(lengths: Sequence[int]) -> list[list[int]]:
    """Return places of lengths that differ by little: all padding falls into one block."""
    groups: list[list[int]] = []
    for k in sorted(range(len(lengths)), key=lambda k: lengths[k]):
        if groups and lengths[k] - lengths[groups[-1][0]] <= PADDING:
            groups[-1].append(k)
        else:
            groups.append([k])
    return groups


def _run_together(ekf: LooselyCoupledEkf, stretches: list[Stretch]) -> list[FeedForward]:
    """Run a feed-forward filter over stretches as one batch."""
    length = max(len(one.samples.dt) for one in stretches)
    most = max(len(one.timing.index) for one in stretches)
    with torch.no_grad():
        history = ekf(
            _stacked([one.start for one in stretches]),
            RissSample(*_padded([one.samples for one in stretches], length)),
            GnssFix(*_padded([one.fixes for one in stretches], most)),
            FixTiming(
                torch.stack([_filled(one.timing.index, most, -1) for one in stretches]),
                torch.stack([_filled(one.timing.delay, most, 0.0) for one in stretches]),
            ),
            method="exact",
        )
    return [
        FeedForward(
            one.samples,
            one.fixes,
            one.timing,
            _one(history, b, len(one.samples.dt)),
            one.begin,
            one.gone,
        )
        for b, one in enumerate(stretches)
    ]


def _stacked(beliefs: list[Belief]) -> Belief:
    state = NavState(*(torch.stack(x) for x in zip(*(b.state for b in beliefs), strict=True)))
    rest = (torch.stack(x) for x in zip(*(b[1:] for b in beliefs), strict=True))
    return Belief(state, *rest)


def _padded(rows: Sequence[tuple[Tensor, ...]], length: int) -> list[Tensor]:
    """Return channels of several records, padded with zeros: intervals that move nothing."""
    return [
        torch.stack([_filled(channel, length, 0.0) for channel in channels])
        for channels in zip(*rows, strict=True)
    ]


def _filled(channel: Tensor, length: int, value: float) -> Tensor:
    return torch.nn.functional.pad(channel, (0, length - len(channel)), value=value)


def _one(history: FilterHistory, row: int, length: int) -> FilterHistory:
    """Return one drive's history out of a batch, without the blocks that pad it."""
    # Intervals that pad a record belong to its last block, or to blocks after it.
    end = history.end[row].clamp(max=length - 1)
    kept = torch.nn.functional.pad(end[1:] != end[:-1], (1, 0), value=True)

    def pick(channel: Tensor) -> Tensor:
        return channel[row][kept]

    return history._replace(
        end=end[kept],
        fix=pick(history.fix),
        prior=map_belief(history.prior, pick),
        belief=map_belief(history.belief, pick),
        trajectory=Trajectory(*(channel[row, :length] for channel in history.trajectory)),
        innovation=pick(history.innovation),
        nis=pick(history.nis),
        verdict=pick(history.verdict),
        resets=history.resets[row],
        error=pick(history.error),
    )
