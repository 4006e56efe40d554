"""One pass of the full-IMU smoother: every block linearised at its guess, smoothed over all.

As for the RISS filter (:mod:`navlearn.fusion.smoothing_pass`): deviations from what blocks
predict from their guessed starts are a linear system, filtered and smoothed in parallel.
"""

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.fusion.gated_pass import Linearised
from navlearn.fusion.ins.composed import by_preintegration, by_product, has_closed_form
from navlearn.fusion.ins.fast_blocks import shift_of_ins_blocks
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.layout import moved_belief, state_difference
from navlearn.fusion.ins.model import InsFilterModel, advanced_sensor
from navlearn.fusion.ins.noise import InsNoise
from navlearn.fusion.ins.recursion import ins_opened
from navlearn.fusion.ins.timeline import InsTimeline
from navlearn.fusion.ins.updates import ins_measured
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.robust import weights
from navlearn.fusion.smoothed_blocks import Evidence, SmoothedPass, smoothed_deviations
from navlearn.states import ImuSample

InsEvidence = Evidence[InsBelief, InsTimeline, InsNoise]


def ins_evidence_of(
    model: InsFilterModel,
    start: InsBelief,
    line: InsTimeline,
    history: InsHistory,
    noise: InsNoise,
) -> InsEvidence:
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
        found = ins_measured(model, history.prior, line.occasion, noise)
        found = found._replace(innovation=torch.nan_to_num(history.innovation))
        extra = ins_opened(model, history.verdict, found)
    weight = weights(model.gate, model.rows, history.nis, history.verdict)
    return InsEvidence(start, line, noise, history.verdict, extra, weight)


def ins_smoothing_pass(
    model: InsFilterModel, evidence: InsEvidence, begin: InsBelief
) -> SmoothedPass[InsBelief]:
    """Filter and smooth deviations from what blocks predict from a guess of their starts.

    Args:
        model: The filter.
        evidence: What the filter was told and what it refused.
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).

    Returns:
        Smoothed beliefs.
    """
    start, line = evidence.start, evidence.line
    end, transition, q = _predicted(model, begin, line.samples, evidence.noise)
    found = ins_measured(model, end, line.occasion, evidence.noise)
    guess = map_ins_belief(begin, lambda x: x[:, 0])
    smoothed = smoothed_deviations(
        model,
        belief_difference(start, guess),
        start.covariance,
        Linearised(transition, shift_of_ins_blocks(begin, end, transition), q, found),
        evidence.verdict,
        evidence.opened,
        evidence.weight,
    )
    mean, covariance = smoothed.mean, smoothed.covariance
    return SmoothedPass(
        moved_belief(guess, mean[:, 0])._replace(covariance=covariance[:, 0]),
        moved_belief(end, mean[:, 1:])._replace(covariance=covariance[:, 1:]),
        transition,
        smoothed.gain,
    )


def _predicted(
    model: InsFilterModel, begin: InsBelief, samples: ImuSample, noise: InsNoise
) -> tuple[InsBelief, Tensor, Tensor]:
    """Return the beliefs at blocks' ends, covariance aside, with Φ and Q of the blocks."""
    compose = by_preintegration if has_closed_form(model) else by_product
    duration = samples.dt.sum(-1)
    # as in the filter, a bias that decays is held at its value in the middle of the block
    held = begin._replace(sensor=advanced_sensor(model, begin.sensor, 0.5 * duration))
    state, transition, q = compose(model, held, samples, noise)
    sensor = advanced_sensor(model, begin.sensor, duration)
    return begin._replace(state=state, sensor=sensor), transition, q


def belief_difference(belief: InsBelief, other: InsBelief) -> Tensor:
    """Return minus the correction by which ``moved_belief`` moves ``belief`` to ``other``.

    Args:
        belief: Belief, batch shape (...).
        other: Belief nearby, batch shape (...).

    Returns:
        ``belief`` minus ``other`` in the order of the error state, shape (..., n).
    """
    parts = (state_difference(belief.state, other.state), belief.sensor - other.sensor)
    return torch.cat(parts, -1)
