"""The filter with all blocks at once: Newton's method on the closed loop.

The states with which all blocks start are the unknowns. A pass mechanizes every block from the
present guess, linearises there, and runs one linear Kalman filter, parallel in time, over all
blocks. Where the guess is what the filter returns, that is the closed-loop filter itself; the
passes converge to it quadratically. The gate's verdicts are found along with the states: those
at a block depend on earlier ones alone, so a set of verdicts that reproduces itself is the one
that the loop would have found.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.batch_axis import wants_gradient
from navlearn.fusion.convergence import solved
from navlearn.fusion.error_state import position_difference
from navlearn.fusion.fast_pass import beliefs_of, linearised_pass
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.first_guess import first_guess
from navlearn.fusion.gated_pass import Behind
from navlearn.fusion.gating import Judged
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.record import Ended, history, path_in_blocks, starts_of_blocks
from navlearn.fusion.timeline import Timeline


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

    learning = torch.is_grad_enabled() and _wants_gradient(start, line, noise)
    found = solved(begin, _Passes(model, start, line, noise), learning)
    if found is None:
        return None
    record, passes = found
    path = path_in_blocks(model, start, record.belief, line)
    return history(line, record, path, "fast", passes)


TOLERANCE = 2e-4
"""Largest move of a block's start in the last pass, m; the next would move a 500th of it."""

ROUGHLY = 0.5
"""The same before passes with gradients, each of which converges too, m."""

TRUSTED = 20.0
"""Largest move in an early pass, m, after which the gate's verdicts are taken over."""


class _Passes(NamedTuple):
    """Passes over the same blocks."""

    model: FilterModel
    start: Belief
    line: Timeline
    noise: EkfNoise

    @property
    def tolerances(self) -> tuple[float, float]:
        return ROUGHLY, TOLERANCE

    def run(self, guess: Belief, said: Judged | None, rounds: int) -> tuple[Ended, Behind]:
        model, start, line, noise = self
        done = linearised_pass(model, start, guess, line, noise, said, rounds)
        return beliefs_of(model, start, line, done), done.behind

    def starts(self, record: Ended) -> Belief:
        return starts_of_blocks(self.start, record.belief)

    def move(self, new: Belief, old: Belief) -> float:
        return largest_move(new, old)

    def trusts(self, new: Belief, old: Belief) -> bool:
        return largest_move(new, old) < TRUSTED

    def detached(self, begin: Belief) -> Belief:
        return map_belief(begin, Tensor.detach)


def largest_move(new: Belief, old: Belief) -> float:
    """Return how far the worst block's start moved, m; azimuth counts as 30 m ahead of the car.

    Args:
        new: Beliefs at which blocks start, batch shape (B, K).
        old: The same before.
    """
    position = position_difference(new.state, old.state).abs().amax()
    azimuth = (new.state.azimuth - old.state.azimuth).abs().amax()
    return float(torch.maximum(position, 30.0 * azimuth))


def _wants_gradient(start: Belief, line: Timeline, noise: EkfNoise) -> bool:
    occasion = line.occasion
    leaves = [*start.state, *start[1:], *line.samples, *occasion.fix, occasion.delay, *noise]
    return wants_gradient(leaves)
