"""The filter with all blocks at once: Newton's method on the closed loop.

The states with which all blocks start are the unknowns. A pass mechanizes every block from the
present guess, linearises there, and runs one linear Kalman filter, parallel in time, over all
blocks. Where the guess is what the filter returns, that is the closed-loop filter itself; the
passes converge to it quadratically. The gate's verdicts are found along with the states: those
at a block depend on earlier ones alone, so a set of verdicts that reproduces itself is the one
that the loop would have found.

Gradients: converge without, then two passes with; the first of them carries what the data do to
the states, the second also what the states do to the linearisation.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.ekf import projected
from navlearn.filters.scan import Filtered, LinearSteps, filter_in_parallel
from navlearn.fusion.error_state import position_difference
from navlearn.fusion.filter_model import (
    FilterModel,
    Prediction,
    difference,
    fed_back,
    predict_blocks,
)
from navlearn.fusion.first_guess import first_guess
from navlearn.fusion.gating import Judged, limits_by_kind, nis_by_kind, opened, taken
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.recursion import Ended, history, path_in_blocks, starts_of_blocks
from navlearn.fusion.timeline import Timeline
from navlearn.fusion.updates import Measured, measured
from navlearn.states import NavState

MOST_PASSES = 20
"""Passes after which the fast form gives up."""

TOLERANCE = 2e-4
"""Largest move of a block's start in the last pass, m; the next would move a 500th of it."""

ROUGHLY = 0.5
"""The same before passes with gradients, each of which converges too, m."""

TRUSTED = 20.0
"""Largest move in a pass, m, after which the gate's verdicts are taken over."""


class Pass(NamedTuple):
    """One pass over all blocks.

    Attributes:
        begin: Beliefs at which blocks were linearised, batch shape (B, K).
        ahead: Their prediction.
        end: Beliefs at the blocks' ends as predicted, batch shape (B, K).
        found: What is measured there.
        filtered: The linear filter's deviations from ``end``.
        innovation: Measured minus predicted by the filter, shape (B, K, r).
        judged: The gate's verdicts on these innovations.
        used: The verdicts that were used to get there, shape (B, K, 5).
    """

    begin: Belief
    ahead: Prediction
    end: Belief
    found: Measured
    filtered: Filtered
    innovation: Tensor
    judged: Judged
    used: Tensor


def linearised_pass(
    model: FilterModel,
    start: Belief,
    begin: Belief,
    line: Timeline,
    noise: EkfNoise,
    verdict: Tensor | None,
    rounds: int,
) -> Pass:
    """Run one pass.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).
        line: The drives in blocks.
        noise: Noise densities and deviations.
        verdict: The gate's verdicts to use, shape (B, K, 5); None believes everything.
        rounds: How often at most verdicts are renewed within the pass.

    Returns:
        The pass.
    """
    ahead = predict_blocks(model, begin, line.samples, line.acceleration, noise)
    end = begin._replace(
        state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
    )
    found = measured(model.measurement, end, line.occasion, noise)
    transition, q = ahead.linearised
    shift = _shift(model, begin, end, line, transition)
    zero = torch.zeros_like(start.covariance[..., 0])
    if verdict is None:
        verdict = (found.present > 0.5).to(torch.int64) * int(Verdict.ACCEPTED)
    innovation = found.innovation
    while True:
        used = taken(model, found, verdict)
        total, extra = q, torch.zeros_like(q)
        if bool((verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
            extra = torch.diag_embed(opened(model, verdict, found, innovation))
            total = q + extra
        steps = LinearSteps(
            transition, shift, total, used.observation, used.variance, used.innovation
        )
        filtered = filter_in_parallel(zero, start.covariance, steps)
        told = (found.observation @ filtered.prior_mean.unsqueeze(-1)).squeeze(-1)
        innovation = found.innovation - told
        # a reset opens the covariance after the gate has judged
        _, spread = projected(filtered.prior_covariance - extra, found.observation)
        nis = nis_by_kind(model, found, innovation, spread)
        new = judged_over_time(model, nis, found.present, start.refused)
        rounds -= 1
        if rounds <= 0 or bool((new.verdict == verdict).all()):
            return Pass(begin, ahead, end, found, filtered, innovation, new, verdict)
        verdict = new.verdict


def _shift(
    model: FilterModel, begin: Belief, end: Belief, line: Timeline, transition: Tensor
) -> Tensor:
    """Return by how much a block's prediction moves because the one before ends elsewhere."""

    def before(x: Tensor) -> Tensor:
        return x[:, :-1]

    def after(x: Tensor) -> Tensor:
        return x[:, 1:]

    last = type(line.occasion.end)(
        type(line.occasion.end.sample)(*map(before, line.occasion.end.sample)),
        before(line.occasion.end.acceleration),
    )
    gap = difference(model, _each(end, before), _each(begin, after), last)
    gap = torch.nn.functional.pad(gap, (0, 0, 1, 0))
    return (transition @ gap.unsqueeze(-1)).squeeze(-1)


def _each(belief: Belief, function: Callable[[Tensor], Tensor]) -> Belief:
    return Belief(NavState(*map(function, belief.state)), *map(function, belief[1:]))


def judged_over_time(model: FilterModel, nis: Tensor, present: Tensor, refused: Tensor) -> Judged:
    """Return which kinds pass the gate at every block.

    Args:
        model: The filter.
        nis: NIS of each kind, shape (B, K, 5).
        present: 1.0 where a kind is measured, shape (B, K, 5).
        refused: Consecutive refusals before the first block, shape (B, 5).

    Returns:
        Verdicts and the refusals after each block.
    """
    there = present > 0.5
    beyond = there & ~(nis.detach() <= limits_by_kind(model, nis))
    verdict = there.to(torch.int64) * int(Verdict.ACCEPTED)
    count = torch.zeros_like(nis)
    odd = beyond.any(1) | (refused > 0.5)
    for b, kind in odd.nonzero().tolist():
        column, counts = _judged_column(
            beyond[b, :, kind].tolist(),
            there[b, :, kind].tolist(),
            float(refused[b, kind]),
            model.options.gate.reset_after,
        )
        verdict[b, :, kind] = torch.tensor(column, device=verdict.device)
        count[b, :, kind] = torch.tensor(counts, dtype=count.dtype, device=count.device)
    return Judged(torch.where(there, nis, torch.nan), verdict, count)


def _judged_column(
    beyond: list[bool], there: list[bool], refused: float, reset_after: int
) -> tuple[list[int], list[float]]:
    verdicts, counts = [], []
    for wild, seen in zip(beyond, there, strict=True):
        verdict = Verdict.ABSENT
        if seen:
            verdict = Verdict.ACCEPTED
            if wild and refused < reset_after:
                verdict = Verdict.REFUSED_BY_GATE
            elif wild:
                verdict = Verdict.ACCEPTED_BY_RESET
            refused = refused + 1.0 if verdict == Verdict.REFUSED_BY_GATE else 0.0
        verdicts.append(int(verdict))
        counts.append(refused)
    return verdicts, counts


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
    found, filtered, occasion = done.found, done.filtered, line.occasion
    prior = fed_back(model, done.end, filtered.prior_mean, occasion.end)
    after = fed_back(model, done.end, filtered.mean, occasion.end)
    before = torch.cat((start.refused.unsqueeze(1), done.judged.refused[:, :-1]), 1)
    there = model.rows.spread(found.present) > 0.5
    return Ended(
        prior._replace(covariance=filtered.prior_covariance, refused=before),
        after._replace(covariance=filtered.covariance, refused=done.judged.refused),
        torch.where(there, done.innovation, torch.nan),
        done.judged,
        filtered.mean if not model.closed else torch.zeros_like(filtered.mean),
    )


def run_fast(
    model: FilterModel, start: Belief, line: Timeline, noise: EkfNoise
) -> FilterHistory | None:
    """Run the filter over all blocks at once.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise densities and deviations.

    Returns:
        History, or None where the passes did not converge or the gate's verdicts oscillate.
    """
    with torch.no_grad():
        begin = first_guess(model, start, line)
    passes = 0
    learning = torch.is_grad_enabled() and _wants_gradient(start, line, noise)
    for tolerance in (ROUGHLY, TOLERANCE) if learning else (TOLERANCE,):
        with torch.no_grad():
            found = _converged(model, start, begin, line, noise, tolerance)
        if found is None:
            return None
        record, settled = found.record, True
        passes += found.passes
        if learning:
            record, settled = _with_gradient(model, start, line, noise, found)
            passes += 2
        if settled:
            path = path_in_blocks(model, start, record.belief, line)
            return history(line, record, path, "fast", passes)
        begin = _each(starts_of_blocks(start, record.belief), Tensor.detach)
    return None


class _Converged(NamedTuple):
    """Where passes without gradients ended: the record, the verdicts behind it, their number."""

    record: Ended
    verdict: Tensor
    passes: int


def _converged(
    model: FilterModel,
    start: Belief,
    begin: Belief,
    line: Timeline,
    noise: EkfNoise,
    tolerance: float,
) -> _Converged | None:
    verdict: Tensor | None = None
    for number in range(1, MOST_PASSES + 1):
        rounds = 1 if number == 1 else 4
        done = linearised_pass(model, start, begin, line, noise, verdict, rounds)
        record = beliefs_of(model, start, line, done)
        new = starts_of_blocks(start, record.belief)
        moved = _largest_move(new, begin)
        begin = new
        if _reproduced(done) and moved < tolerance:
            return _Converged(record, done.judged.verdict, number)
        # what a first pass refuses may only be far from its guess
        verdict = done.judged.verdict if moved < TRUSTED else None
    return None


def _with_gradient(
    model: FilterModel, start: Belief, line: Timeline, noise: EkfNoise, found: _Converged
) -> tuple[Ended, bool]:
    """Return the record of two more passes with gradients, and whether they changed nothing."""
    record = found.record
    for _ in range(2):
        # the first block starts where the caller said: that carries its gradient
        begin = starts_of_blocks(start, record.belief)
        done = linearised_pass(model, start, begin, line, noise, found.verdict, 0)
        record = beliefs_of(model, start, line, done)
    with torch.no_grad():
        moved = _largest_move(starts_of_blocks(start, record.belief), begin)
    return record, _reproduced(done) and moved < TOLERANCE


def _reproduced(done: Pass) -> bool:
    return bool((done.judged.verdict == done.used).all())


def _largest_move(new: Belief, old: Belief) -> float:
    """Return how far the worst block's start moved, m; azimuth counts as 30 m ahead of the car."""
    position = position_difference(new.state, old.state).abs().amax()
    azimuth = (new.state.azimuth - old.state.azimuth).abs().amax()
    return float(torch.maximum(position, 30.0 * azimuth))


def _wants_gradient(start: Belief, line: Timeline, noise: EkfNoise) -> bool:
    occasion = line.occasion
    leaves = [*start.state, *start[1:], *line.samples, *occasion.fix, occasion.delay, *noise]
    return any(leaf.requires_grad for leaf in leaves)
