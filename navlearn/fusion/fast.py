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

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.error_state import position_difference
from navlearn.fusion.fast_pass import Pass, beliefs_of, linearised_pass
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.first_guess import first_guess
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.record import Ended, history, path_in_blocks, starts_of_blocks
from navlearn.fusion.timeline import Timeline

MOST_PASSES = 20
"""Passes after which the fast form gives up."""

TOLERANCE = 2e-4
"""Largest move of a block's start in the last pass, m; the next would move a 500th of it."""

ROUGHLY = 0.5
"""The same before passes with gradients, each of which converges too, m."""

TRUSTED = 20.0
"""Largest move in an early pass, m, after which the gate's verdicts are taken over."""

EARLY = 3
"""Passes that may still be far from the solution; a later one that moves far was told to by the
verdicts, and forgetting them would only bring back the pass before."""


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
        begin = map_belief(starts_of_blocks(start, record.belief), Tensor.detach)
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
        verdict = done.judged.verdict if moved < TRUSTED or number > EARLY else None
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
