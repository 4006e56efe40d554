"""One pass of the smoother: every block linearised at its guess, filtered and smoothed over all."""

import torch
from torch import Tensor

from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.fast_pass import shift_of_blocks
from navlearn.fusion.filter_model import FilterModel, difference, fed_back, predict_blocks
from navlearn.fusion.gated_pass import Linearised
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.opening import opened
from navlearn.fusion.robust import weights
from navlearn.fusion.smoothed_blocks import Evidence, SmoothedPass, smoothed_deviations
from navlearn.fusion.timeline import Timeline
from navlearn.fusion.updates import measured
from navlearn.states import RissSample

RissEvidence = Evidence[Belief, Timeline, EkfNoise]


def evidence_of(
    model: FilterModel, start: Belief, line: Timeline, history: FilterHistory, noise: EkfNoise
) -> RissEvidence:
    """Return what a filter's history holds against drives.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        history: What the filter made of them.
        noise: Noise densities and deviations.

    Returns:
        Verdicts, what resets opened, and weights.
    """
    extra = torch.zeros_like(history.belief.covariance[..., 0])
    if bool((history.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
        found = measured(model.measurement, history.prior, line.occasion, noise)
        extra = opened(model, history.verdict, found, torch.nan_to_num(history.innovation))
    weight = weights(model.gate, model.rows, history.nis, history.verdict)
    return RissEvidence(start, line, noise, history.verdict, extra, weight)


def smoothing_pass(
    model: FilterModel, evidence: RissEvidence, begin: Belief
) -> SmoothedPass[Belief]:
    """Filter and smooth deviations from what blocks predict from a guess of their starts.

    Args:
        model: The filter.
        evidence: What the filter was told and what it refused.
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).

    Returns:
        Smoothed beliefs.
    """
    start, line = evidence.start, evidence.line
    ahead = predict_blocks(model, begin, line.samples, line.acceleration, evidence.noise)
    end = begin._replace(
        state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
    )
    found = measured(model.measurement, end, line.occasion, evidence.noise)
    transition, q = ahead.linearised
    shift = shift_of_blocks(model, begin, end, line, transition)
    guess, opening = map_belief(begin, _first_block), _opening(line)
    smoothed = smoothed_deviations(
        model,
        difference(model, start, guess, opening),
        start.covariance,
        Linearised(transition, shift, q, found),
        evidence.verdict,
        evidence.opened,
        evidence.weight,
    )
    mean, covariance = smoothed.mean, smoothed.covariance
    before = fed_back(model, guess, mean[:, 0], opening)
    after = fed_back(model, end, mean[:, 1:], line.occasion.end)
    return SmoothedPass(
        before._replace(covariance=covariance[:, 0]),
        after._replace(covariance=covariance[:, 1:]),
        transition,
        smoothed.gain,
    )


def _opening(line: Timeline) -> BlockEnd:
    """Return the first sample of drives: what a belief before it is told of the odometer."""
    sample = RissSample(*(channel[:, 0, 0] for channel in line.samples))
    return BlockEnd(sample, line.acceleration[:, 0, 0])


def _first_block(x: Tensor) -> Tensor:
    return x[:, 0]
