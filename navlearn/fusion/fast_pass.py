"""One pass of the fast form: every block linearised at its guess, one linear filter over all."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.filter_model import (
    FilterModel,
    Prediction,
    difference,
    fed_back,
    predict_blocks,
)
from navlearn.fusion.gated_pass import Behind, Linearised, filtered_behind_gate
from navlearn.fusion.gating import Judged
from navlearn.fusion.measured import Measured
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.opening import opened
from navlearn.fusion.record import Ended
from navlearn.fusion.timeline import Timeline
from navlearn.fusion.updates import measured


class Pass(NamedTuple):
    """One pass over all blocks.

    Attributes:
        begin: Beliefs at which blocks were linearised, batch shape (B, K).
        ahead: Their prediction.
        end: Beliefs at the blocks' ends as predicted, batch shape (B, K).
        found: What is measured there.
        behind: The linear filter's deviations from ``end``, and the gate's verdicts.
    """

    begin: Belief
    ahead: Prediction
    end: Belief
    found: Measured
    behind: Behind


def linearised_pass(
    model: FilterModel,
    start: Belief,
    begin: Belief,
    line: Timeline,
    noise: EkfNoise,
    said: Judged | Tensor | None,
    rounds: int,
) -> Pass:
    """Run one pass.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).
        line: The drives in blocks.
        noise: Noise densities and deviations.
        said: The gate's verdicts and weights to use, or verdicts alone; None believes everything.
        rounds: How often at most they are renewed within the pass.

    Returns:
        The pass.
    """
    ahead = predict_blocks(model, begin, line.samples, line.acceleration, noise)
    end = begin._replace(
        state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
    )
    found = measured(model.measurement, end, line.occasion, noise)
    transition, q = ahead.linearised
    shift = shift_of_blocks(model, begin, end, line, transition)
    behind = filtered_behind_gate(
        model,
        start.covariance,
        start.refused,
        Linearised(transition, shift, q, found),
        said,
        rounds,
        lambda v, innovation: opened(model, v, found, innovation),
    )
    return Pass(begin, ahead, end, found, behind)


def shift_of_blocks(
    model: FilterModel, begin: Belief, end: Belief, line: Timeline, transition: Tensor
) -> Tensor:
    """Return by how much a block's prediction moves because the one before ends elsewhere.

    Args:
        model: The filter.
        begin: Beliefs at which blocks were linearised, batch shape (B, K).
        end: Beliefs at the blocks' ends as predicted from there, batch shape (B, K).
        line: The drives in blocks.
        transition: Φ of each block, shape (B, K, n, n).

    Returns:
        Shift in the order of the error state, zero for the first block, shape (B, K, n).
    """

    def before(x: Tensor) -> Tensor:
        return x[:, :-1]

    def after(x: Tensor) -> Tensor:
        return x[:, 1:]

    last = type(line.occasion.end)(
        type(line.occasion.end.sample)(*map(before, line.occasion.end.sample)),
        before(line.occasion.end.acceleration),
    )
    gap = difference(model, map_belief(end, before), map_belief(begin, after), last)
    gap = torch.nn.functional.pad(gap, (0, 0, 1, 0))
    return (transition @ gap.unsqueeze(-1)).squeeze(-1)


def beliefs_of(model: FilterModel, start: Belief, line: Timeline, done: Pass) -> Ended:
    """Return every block's end as a pass has it.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        done: The pass.

    Returns:
        Record, batch shape (B, K).
    """
    found, filtered, occasion = done.found, done.behind.filtered, line.occasion
    judged = done.behind.judged
    prior = fed_back(model, done.end, filtered.prior_mean, occasion.end)
    after = fed_back(model, done.end, filtered.mean, occasion.end)
    before = torch.cat((start.refused.unsqueeze(1), judged.refused[:, :-1]), 1)
    there = model.rows.spread(found.present) > 0.5
    return Ended(
        prior._replace(covariance=filtered.prior_covariance, refused=before),
        after._replace(covariance=filtered.covariance, refused=judged.refused),
        torch.where(there, done.behind.innovation, torch.nan),
        judged,
        filtered.mean if not model.closed else torch.zeros_like(filtered.mean),
    )
