"""Smoothing a drive: what the filter would have believed, had it known the fixes to come.

Rauch–Tung–Striebel over the filter's own blocks [Rauch1965]: deviations from what each block
predicts are filtered and smoothed as a linear system. One pass about the filter's own beliefs is
the classical smoother; passes about what was smoothed before are the iterated one, which is
Gauss–Newton on the whole drive [Bell1994], and which a drift of some degrees needs. What the
gate refused stays refused, and where it reset nothing is known across: the covariance opened
there is process noise.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.filters.belief import Belief, map_belief
from navlearn.filters.scan import LinearSteps, filter_in_parallel
from navlearn.filters.smoother import Smoothed, forward_pass, smooth_in_parallel
from navlearn.fusion.fast_pass import shift_of_blocks
from navlearn.fusion.filter_model import (
    FilterModel,
    Prediction,
    difference,
    fed_back,
    predict_blocks,
)
from navlearn.fusion.gating import opened, taken
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.smoothed_path import smoothed_path
from navlearn.fusion.timeline import Timeline, timeline
from navlearn.fusion.updates import measured
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory


@dataclass(frozen=True, kw_only=True)
class SmoothingOptions:
    """How a drive is smoothed.

    Attributes:
        passes: Most passes; 1 is the classical smoother about the filter's beliefs.
        tolerance: Largest move of a block's start in the last pass, m; azimuth counts as 30 m
            ahead of the car.
        give_up: Where the last pass still moves a start further than this, m, the passes do not
            converge, and the classical smoother's result is returned.
    """

    passes: int = 10
    tolerance: float = 1e-3
    give_up: float = 0.1


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


class _Evidence(NamedTuple):
    """What all passes share: the gate's verdicts, and the variance its resets opened."""

    start: Belief
    line: Timeline
    noise: EkfNoise
    verdict: Tensor
    opened: Tensor


class _Pass(NamedTuple):
    start: Belief
    belief: Belief
    ahead: Prediction
    gain: Tensor


def smooth(
    ekf: LooselyCoupledEkf,
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
        options: Passes; None means the defaults.

    Returns:
        Smoothed drives; without batch axis where the input had none.

    Raises:
        ShapeError: The history is not that of these samples and fixes.
    """
    if samples.dt.dim() == 1:
        batched = smooth(
            ekf,
            map_belief(start, _unsqueezed),
            RissSample(*map(_unsqueezed, samples)),
            GnssFix(*map(_unsqueezed, fixes)),
            FixTiming(*map(_unsqueezed, timing)),
            _with_batch(history),
            options,
        )
        return _without_batch(batched)
    model, chosen = ekf.model, options or SmoothingOptions()
    line = timeline(model, samples, fixes, timing)
    if history.end.shape != line.blocks.end.shape or bool((history.end != line.blocks.end).any()):
        raise ShapeError(
            f"smoothing: the history has {history.end.shape[-1]} blocks that end elsewhere than "
            f"the {line.blocks.end.shape[-1]} of these samples and fixes; pass what the filter ran "
            "on, and the filter itself"
        )
    evidence = _Evidence(
        start, line, ekf.noise, history.verdict, _opened(model, history, line, ekf.noise)
    )
    found, passes = _iterated(model, evidence, history.belief, chosen)
    return SmoothedDrive(
        line.blocks.end,
        found.start,
        found.belief,
        smoothed_path(model, found.start, found.belief, line),
        found.ahead.linearised.transition,
        found.gain,
        passes,
    )


def _iterated(
    model: FilterModel, evidence: _Evidence, belief: Belief, options: SmoothingOptions
) -> tuple[_Pass, int]:
    first = found = _smoothing_pass(model, evidence, starts_of_blocks(evidence.start, belief))
    moved = 0.0
    for number in range(2, options.passes + 1):
        begin = starts_of_blocks(found.start, found.belief)
        found = _smoothing_pass(model, evidence, begin)
        moved = _largest_move(starts_of_blocks(found.start, found.belief), begin)
        if moved < options.tolerance:
            return found, number
    # written so that NaN, which is not below anything, gives up too
    return (found, options.passes) if moved < options.give_up else (first, 1)


def _smoothing_pass(model: FilterModel, evidence: _Evidence, begin: Belief) -> _Pass:
    """Filter and smooth deviations from what blocks predict from a guess of their starts."""
    start, line = evidence.start, evidence.line
    ahead = predict_blocks(model, begin, line.samples, line.acceleration, evidence.noise)
    end = begin._replace(
        state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
    )
    found = measured(model.measurement, end, line.occasion, evidence.noise)
    used = taken(model, found, evidence.verdict)
    transition, q = ahead.linearised
    steps = LinearSteps(
        transition,
        shift_of_blocks(model, begin, end, line, transition),
        q + torch.diag_embed(evidence.opened),
        used.observation,
        used.variance,
        used.innovation,
    )
    guess, opening = map_belief(begin, _first_block), _opening(line)
    prior = difference(model, start, guess, opening)
    filtered = filter_in_parallel(prior, start.covariance, steps)
    smoothed: Smoothed = smooth_in_parallel(forward_pass(prior, start.covariance, steps, filtered))
    mean, covariance = smoothed.mean, smoothed.covariance
    before = fed_back(model, guess, mean[:, 0], opening)
    after = fed_back(model, end, mean[:, 1:], line.occasion.end)
    return _Pass(
        before._replace(covariance=covariance[:, 0]),
        after._replace(covariance=covariance[:, 1:]),
        ahead,
        smoothed.gain,
    )


def _opened(model: FilterModel, history: FilterHistory, line: Timeline, noise: EkfNoise) -> Tensor:
    """Return the variance that the gate's resets added at the ends of blocks, shape (B, K, n)."""
    if not bool((history.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
        return torch.zeros_like(history.belief.covariance[..., 0])
    found = measured(model.measurement, history.prior, line.occasion, noise)
    return opened(model, history.verdict, found, torch.nan_to_num(history.innovation))


def _opening(line: Timeline) -> BlockEnd:
    """Return the first sample of drives: what a belief before it is told of the odometer."""
    sample = RissSample(*(channel[:, 0, 0] for channel in line.samples))
    return BlockEnd(sample, line.acceleration[:, 0, 0])


def _largest_move(new: Belief, old: Belief) -> float:
    move = torch.stack(
        [
            6.4e6 * (new.state.lat - old.state.lat).abs().amax(),
            6.4e6 * (new.state.lon - old.state.lon).abs().amax(),
            30.0 * (new.state.azimuth - old.state.azimuth).abs().amax(),
        ]
    )
    return float(move.amax())


def _first_block(x: Tensor) -> Tensor:
    return x[:, 0]


def _unsqueezed(x: Tensor) -> Tensor:
    return x.unsqueeze(0)


def _first(x: Tensor) -> Tensor:
    return x[0]


def _with_batch(history: FilterHistory) -> FilterHistory:
    return history._replace(
        end=history.end.unsqueeze(0),
        prior=map_belief(history.prior, _unsqueezed),
        belief=map_belief(history.belief, _unsqueezed),
        innovation=history.innovation.unsqueeze(0),
        verdict=history.verdict.unsqueeze(0),
    )


def _without_batch(drive: SmoothedDrive) -> SmoothedDrive:
    return SmoothedDrive(
        drive.end[0],
        map_belief(drive.start, _first),
        map_belief(drive.belief, _first),
        Trajectory(*map(_first, drive.trajectory)),
        drive.transition[0],
        drive.gain[0],
        drive.passes,
    )
