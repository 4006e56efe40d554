"""The full-IMU filter with all blocks at once: Newton's method on the closed loop.

The samples of all blocks are preintegrated side by side. A pass carries every block over its
increments from the present guess of its start, linearises there, and runs one linear Kalman
filter, parallel in time, over all blocks; where the guess is what the filter returns, that is the
closed-loop filter itself. Increments follow new sensor parameters to first order until the passes
are near; from there on they are summed up again wherever that would change them. Gradients of two
passes are those of the loop to a few thousandths at worst, where innovations are large.
"""

import math

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.fusion.batch_axis import wants_gradient
from navlearn.fusion.convergence import solved
from navlearn.fusion.gated_pass import Behind, Linearised, filtered_behind_gate
from navlearn.fusion.gating import Judged
from navlearn.fusion.ins.composed import has_closed_form
from navlearn.fusion.ins.fast_blocks import RenewedSums, Sums
from navlearn.fusion.ins.first_guess import first_ins_guess
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.layout import moved_belief, state_difference
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.noise import InsNoise
from navlearn.fusion.ins.path import ins_path_in_blocks
from navlearn.fusion.ins.recursion import InsEnded, ins_history, ins_opened
from navlearn.fusion.ins.timeline import InsTimeline
from navlearn.fusion.ins.updates import ins_measured
from navlearn.fusion.measured import Measured
from navlearn.fusion.record import starts_of_blocks

TOLERANCE = 5e-3
"""Largest move of a block's start in the last pass, m; the next would move a 50th of it."""

ROUGHLY = 0.3
"""The same before passes with gradients, each of which converges too, m."""


def run_ins_fast(
    model: InsFilterModel, start: InsBelief, line: InsTimeline, noise: InsNoise
) -> InsHistory | None:
    """Run the filter over all blocks at once.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise densities and deviations.

    Returns:
        History, or None where there is no closed form for the model, the passes did not converge,
        or the gate's verdicts oscillate.
    """
    if not has_closed_form(model) or not model.closed:
        return None
    passes = _Passes(model, start, line, noise)
    with torch.no_grad():
        begin = first_ins_guess(model, start, line, passes.sums.pre)
    learning = torch.is_grad_enabled() and _wants_gradient(start, line, noise)
    found = solved(begin, passes, learning)
    if found is None:
        return None
    record, number = found
    path = ins_path_in_blocks(model, start, record.belief, line)
    return ins_history(line, record, path, "fast", number)


def largest_move(new: InsBelief, old: InsBelief) -> float:
    """Return how far the worst block's start moved, m.

    Velocity counts over a second, attitude over 30 m.

    Args:
        new: Beliefs at which blocks start, batch shape (B, K).
        old: The same before.
    """
    moved = state_difference(new.state, old.state).abs().flatten(0, -2).amax(0)
    size = moved.new_tensor([1.0] * 6 + [30.0] * 3)
    return float((moved * size).amax())


class _Passes:
    """Passes over the same blocks, and the sums over samples that they share."""

    def __init__(
        self, model: InsFilterModel, start: InsBelief, line: InsTimeline, noise: InsNoise
    ) -> None:
        self.model, self.start, self.line, self.noise = model, start, line, noise
        self.blocks = RenewedSums(model, start, line.samples, noise)

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        return ROUGHLY, TOLERANCE

    @property
    def sums(self) -> Sums:
        """What the samples of all blocks say, as the last pass took it."""
        return self.blocks.sums

    def run(self, guess: InsBelief, said: Judged | None, rounds: int) -> tuple[InsEnded, Behind]:
        """Run one pass."""
        model, start, occasion = self.model, self.start, self.line.occasion
        ahead = self.blocks.ahead(guess)
        found = ins_measured(model, ahead.end, occasion, self.noise)
        behind = filtered_behind_gate(
            model,
            start.covariance,
            start.refused,
            Linearised(ahead.transition, ahead.shift, ahead.noise, found),
            said,
            rounds,
            lambda v, innovation: ins_opened(model, v, found._replace(innovation=innovation)),
        )
        return _ended(model, start, ahead.end, found, behind), behind

    def move(self, new: InsBelief, old: InsBelief) -> float:
        """Return how far blocks moved, m; infinite before the sums are final."""
        return largest_move(new, old) if self.blocks.settled else math.inf

    def trusts(self, new: InsBelief, old: InsBelief) -> bool:
        """Return whether a pass came near."""
        return self.blocks.came_near(new, old)

    def starts(self, record: InsEnded) -> InsBelief:
        """Return where blocks start by what a pass found, batch shape (B, K)."""
        return starts_of_blocks(self.start, record.belief)

    def detached(self, begin: InsBelief) -> InsBelief:
        """Return the same beliefs without gradients."""
        return map_ins_belief(begin, Tensor.detach)


def _ended(
    model: InsFilterModel, start: InsBelief, end: InsBelief, found: Measured, behind: Behind
) -> InsEnded:
    """Return every block's end as a pass has it."""
    filtered, judged = behind.filtered, behind.judged
    before = torch.cat((start.refused.unsqueeze(1), judged.refused[:, :-1]), 1)
    prior, after = moved_belief(end, filtered.prior_mean), moved_belief(end, filtered.mean)
    there = model.rows.spread(found.present) > 0.5
    return InsEnded(
        prior._replace(covariance=filtered.prior_covariance, refused=before),
        after._replace(covariance=filtered.covariance, refused=judged.refused),
        torch.where(there, behind.innovation, torch.nan),
        judged,
        torch.zeros_like(filtered.mean),
    )


def _wants_gradient(start: InsBelief, line: InsTimeline, noise: InsNoise) -> bool:
    occasion = line.occasion
    leaves = [*start.state, *start[1:], *line.samples, *occasion.fix, occasion.delay, *noise]
    return wants_gradient(leaves)
