"""The filter once more over parts of a drive, with a gyro that a model has corrected.

A filter that saw the raw gyro put the model's corrections into its bias and azimuth. So it is
run again over what came before, from a bias that it may choose anew.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.error_state import error_layout
from navlearn.fusion.history import FilterHistory
from navlearn.navigator import Navigator, NavigatorRun, belief_at
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory


class Stretch(NamedTuple):
    """A part of a drive to filter once more.

    Attributes:
        block: The filter starts from what it believed after this block of the run.
        gone: No fix is used at this sample of the run or later.
        stop: The first sample no longer filtered.
    """

    block: int
    gone: int
    stop: int


def filter_stretches(
    navigator: Navigator,
    run: NavigatorRun,
    fixes: GnssFix,
    timing: FixTiming,
    stretches: Sequence[Stretch],
    rate_errors: Sequence[Tensor] | None = None,
) -> FilterHistory:
    """Filter parts of a drive side by side.

    Args:
        navigator: The filter.
        run: Its run over the drive.
        fixes: The drive's fixes, shape (M,) each.
        timing: Where they fall among the drive's intervals, shape (M,) each.
        stretches: The parts, B of them.
        rate_errors: Error of the yaw rate to take off in each, rad/s, shape (L,) each; the bias
            is then free again. None leaves the gyro and what was believed as they were.

    Returns:
        History of shape (B, ...); indices count from the sample after each part's ``block``.
    """
    ends = run.history.end
    begins = [int(ends[one.block]) + 1 for one in stretches]
    length = max(one.stop - begin for one, begin in zip(stretches, begins, strict=True))
    parts, kept = [], []
    index = timing.index - run.first
    for k, (one, begin) in enumerate(zip(stretches, begins, strict=True)):
        part = RissSample(*(channel[begin : one.stop] for channel in run.samples))
        if rate_errors is not None:
            part = part._replace(yaw_rate=part.yaw_rate - rate_errors[k])
        missing = length - (one.stop - begin)
        # Padded with a drive straight on that no one looks at: intervals of no length would all
        # fall into one block, as long as which all others would be made.
        last = RissSample(*(channel[-1:].expand(missing) for channel in part))
        parts.append(RissSample(*map(_joined, part, last)))
        kept.append((index >= begin) & (index < one.gone))
    samples = RissSample(*(torch.stack(channel) for channel in zip(*parts, strict=True)))
    count = max(int(mask.sum()) for mask in kept)
    chosen = [_padded(torch.nonzero(mask).squeeze(-1), count) for mask in kept]
    places = [
        torch.where(rows >= 0, index[rows.clamp(min=0)] - begin, -1)
        for rows, begin in zip(chosen, begins, strict=True)
    ]
    rows = torch.stack(chosen).clamp(min=0)
    belief = belief_at(run.history, torch.tensor([one.block for one in stretches]))
    with torch.no_grad():
        history: FilterHistory = navigator.filter(
            belief if rate_errors is None else _bias_set_free(belief, navigator),
            samples,
            GnssFix(*(channel[rows] for channel in fixes)),
            FixTiming(torch.stack(places), timing.delay[rows]),
            method=navigator.options.method,
        )
    return history


def without_batch(history: FilterHistory) -> FilterHistory:
    """Return the history of the only one of a batch."""
    return history._replace(
        end=history.end[0],
        belief=map_belief(history.belief, lambda channel: channel[0]),
        trajectory=Trajectory(*(channel[0] for channel in history.trajectory)),
    )


def _bias_set_free(belief: Belief, navigator: Navigator) -> Belief:
    """Return the belief with as little known of the gyro bias as before the drive."""
    options = navigator.options.filter
    layout = error_layout(options)
    if "gyro_bias" not in layout.names:
        return belief
    at = layout.names.index("gyro_bias")
    covariance = belief.covariance.clone()
    covariance[..., at, :] = 0.0
    covariance[..., :, at] = 0.0
    covariance[..., at, at] = options.initial.gyro["bias"] ** 2
    return belief._replace(covariance=covariance)


def _joined(part: Tensor, last: Tensor) -> Tensor:
    return torch.cat((part, last))


def _padded(rows: Tensor, count: int) -> Tensor:
    return torch.nn.functional.pad(rows, (0, count - len(rows)), value=-1)
