"""Partial outages emulated in the past of a drive: the same satellites stay, the others go."""

from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor

from navlearn.frames import enu_between
from navlearn.fusion.measurements import believed
from navlearn.fusion.start import told_from
from navlearn.fusion.tight.history import TightHistory
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.states import FixTiming, ImuSample, InsState, RissSample, SatelliteRanges, Trajectory
from navlearn.tight_navigator import TightNavigator, TightNavigatorRun, tight_belief_at

Tensors = TypeVar("Tensors")

GOOD = 0.8
"""Share of the receptions in which what stays must be there, and the reference be a solution."""


class HeardBefore(NamedTuple):
    """The receptions that made a run.

    Attributes:
        ranges: Shape (M, S) each.
        timing: Where they fall among the run's samples, shape (M,) each.
        t: Their times, s, shape (M,).
    """

    ranges: SatelliteRanges
    timing: FixTiming
    t: Tensor


class Replays(NamedTuple):
    """N emulated partial outages of L samples and at most M receptions.

    Attributes:
        block: Block of the run after which each starts, int64, shape (N,).
        samples: Intervals, shape (N, L) each.
        ranges: Receptions of the satellites that stay, shape (N, M, S) each; systems (S,).
        timing: Where they fall, index −1 for padding, shape (N, M) each.
        reception: Which of the run's receptions they are, int64, −1 for padding, shape (N, M).
        reference: What the filter knew with all satellites, shape (N, L) each.
    """

    block: Tensor
    samples: RissSample | ImuSample
    ranges: SatelliteRanges
    timing: FixTiming
    reception: Tensor
    reference: Trajectory | InsState


def heard_before(
    run: TightNavigatorRun, ranges: SatelliteRanges, timing: FixTiming, t: Tensor
) -> HeardBefore:
    """Return the receptions that a run's filter was given, of those that its navigator was.

    Args:
        run: The run.
        ranges: What the navigator was given, shape (M, S) each.
        timing: Where they fall among the drive's samples, shape (M,) each.
        t: Their times, s, shape (M,).
    """
    kept, placed = told_from(ranges, timing, run.first)
    return HeardBefore(kept, placed, t[timing.index >= run.first])


def recent_replays(
    run: TightNavigatorRun, heard: HeardBefore, visible: Tensor, spec: RangeErrorSpec
) -> Replays | None:
    """Return the last partial outages that can be emulated before a run's end.

    Args:
        run: A run with all satellites, up to an outage's start.
        heard: Its receptions.
        visible: Satellites that stay, bool, shape (S,).
        spec: Tells lengths, distances and numbers.

    Returns:
        None where there is none: too short a past, or satellites that were not there.
    """
    dt = float(run.samples.dt.median())
    length = round(spec.gate_horizon_s / dt)
    starts = _starts(run, heard, visible, spec, length, dt)
    if len(starts) == 0:
        return None
    block = torch.tensor(starts)
    rows = run.history.end[block].unsqueeze(-1) + 1 + torch.arange(length)
    spans = [_between(heard, run.history, k, length) for k in starts]
    most = max(len(span) for span in spans)
    reception = torch.full((len(starts), most), -1)
    for row, span in zip(reception, spans, strict=True):
        row[: len(span)] = span
    first = run.history.end[block].unsqueeze(-1) + 1
    index = heard.timing.index[reception.clamp(min=0)] - first
    there = reception >= 0
    path = run.history.trajectory
    return Replays(
        block=block,
        samples=type(run.samples)(*(channel[rows] for channel in run.samples)),
        ranges=only(_chosen(heard.ranges, reception.clamp(min=0)), visible & there.unsqueeze(-1)),
        timing=FixTiming(
            torch.where(there, index, -1),
            torch.where(there, heard.timing.delay[reception.clamp(min=0)], 0.0),
        ),
        reception=reception,
        reference=type(path)(*(channel[rows] for channel in path)),
    )


def _starts(
    run: TightNavigatorRun,
    heard: HeardBefore,
    visible: Tensor,
    spec: RangeErrorSpec,
    length: int,
    dt: float,
) -> list[int]:
    """Return the blocks after which outages are emulated, in order of time."""
    history = run.history
    slots = visible.shape[-1]
    taken = believed(history.verdict[:, :slots])
    closes = torch.ones_like(history.end, dtype=torch.bool)
    closes[:-1] = history.end[1:] != history.end[:-1]
    usable = (history.reception >= 0) & closes
    last = len(run.samples.dt) - length
    first = round((spec.fewest_rows * spec.step_s) / dt)
    found: list[int] = []
    for k in reversed(torch.nonzero(usable).squeeze(-1).tolist()):
        end = int(history.end[k])
        if end + 1 > last or (found and int(history.end[found[-1]]) - end < spec.gate_every_s / dt):
            continue
        if end < first or len(found) == spec.gate_replays:
            break
        span = _between(heard, history, k, length)
        through = (history.end > end) & (history.end <= end + length) & (history.reception >= 0)
        if len(span) == 0 or not bool(through.any()):
            continue
        stay = heard.ranges.has_range[span][:, visible] > 0.5
        full = taken[through].sum(-1) >= spec.min_satellites
        if float(stay.double().mean(0).amin()) >= GOOD and float(full.double().mean()) >= GOOD:
            found.append(k)
    return found[::-1]


def _between(heard: HeardBefore, history: TightHistory, block: int, length: int) -> Tensor:
    """Return the receptions after a block that fall into the samples that follow."""
    end = int(history.end[block])
    index = heard.timing.index
    later = torch.arange(len(index)) > int(history.reception[block])
    return torch.nonzero(later & (index > end) & (index <= end + length)).squeeze(-1)


def _chosen(ranges: SatelliteRanges, reception: Tensor) -> SatelliteRanges:
    kept = {
        name: getattr(ranges, name)[reception]
        for name in SatelliteRanges._fields
        if name != "system"
    }
    return ranges._replace(**kept)


def only(ranges: SatelliteRanges, visible: Tensor) -> SatelliteRanges:
    """Return ranges of which only some satellites are there.

    Args:
        ranges: Shape (..., M, S) each.
        visible: Which stay, bool, broadcast against them.
    """
    stays = visible.to(ranges.has_range)
    return ranges._replace(has_range=ranges.has_range * stays, has_rate=ranges.has_rate * stays)


def run_replays(
    navigator: TightNavigator, run: TightNavigatorRun, replays: Replays, ranges: SatelliteRanges
) -> TightHistory:
    """Return the filter's runs through emulated outages, batch shape (N,).

    Args:
        navigator: What made the run.
        run: The run.
        replays: The outages.
        ranges: Their receptions, as an error model corrected them or as they are.
    """
    belief = tight_belief_at(run.history, replays.block)
    filter_ = navigator.filter(belief.clock.shape[-1] - 1)
    with torch.no_grad():
        history: TightHistory = filter_(
            belief,
            replays.samples,
            ranges,
            replays.timing,
            method=navigator.options.method,
            silence=torch.zeros_like(replays.samples.dt[:, 0]),
        )
    return history


def one_of(tensors: Tensors, k: int) -> Tensors:
    """Return one drive of a batch: named tuples of tensors at an index of their first axis.

    Args:
        tensors: Named tuple; what in it is no tensor, and the systems of satellites, stay.
        k: Index.
    """

    def at(value: Any) -> Any:
        if isinstance(value, SatelliteRanges):
            named = value._asdict().items()
            return SatelliteRanges(**{n: v if n == "system" else at(v) for n, v in named})
        if isinstance(value, Tensor):
            return value[k]
        return type(value)(*map(at, value)) if isinstance(value, tuple) else value

    found: Tensors = at(tensors)
    return found


def rms_error(path: Trajectory | InsState, reference: Trajectory | InsState) -> Tensor:
    """Return the root mean square of the horizontal distance, m, shape (N,).

    Args:
        path: Solutions, shape (N, L) each.
        reference: What they are compared with, likewise.
    """
    east, north, _ = enu_between(
        path.lat, path.lon, path.height, reference.lat, reference.lon, reference.height
    )
    return (east.square() + north.square()).mean(-1).sqrt()
