"""The tightly coupled filter with all blocks at once: Newton's method on the closed loop.

As :mod:`navlearn.fusion.fast`: the beliefs with which all blocks start are the unknowns, a pass
linearises every block at a guess of them and runs one linear filter, parallel in time, and what
is believed of every satellite is found along with them. What reproduces itself is what the loop
would have found.
"""

from typing import Any

import torch
from torch import Tensor, nn

from navlearn.filters.tight_belief import TightBelief, map_tight_belief, map_tree
from navlearn.fusion.batch_axis import wants_gradient
from navlearn.fusion.convergence import solved
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.tight.fast_gate import Said
from navlearn.fusion.tight.fast_pass import BehindRanges, Linear, filtered_behind_ranges
from navlearn.fusion.tight.first_guess import first_tight_guess
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.packing import packed_reception
from navlearn.fusion.tight.passes import VehiclePasses
from navlearn.fusion.tight.prediction import TightAhead, beside_clock
from navlearn.fusion.tight.ranges import measured_ranges, variance_in_series, with_surprise
from navlearn.fusion.tight.record import tight_history
from navlearn.fusion.tight.timeline import TightLine
from navlearn.fusion.tight.update import TightEnded, fed_back, with_covariance


def run_tight_fast(
    model: TightModel, start: TightBelief[Any], line: TightLine, noise: TightNoise
) -> TightHistory | None:
    """Run the filter over all blocks at once.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise of ranges and clock.

    Returns:
        History, or None where the vehicle has no such form, the passes did not converge, or what is
        believed oscillates.
    """
    of_vehicle = model.vehicle.passes(start.vehicle, line.vehicle)
    if of_vehicle is None:
        return None
    passes = _Passes(model, start, line, noise, of_vehicle)
    begin = first_tight_guess(model, start, passes.reception, of_vehicle)
    learning = torch.is_grad_enabled() and _wants_gradient(model, start, line, noise)
    found = solved(begin, passes, learning)
    if found is None:
        return None
    record, number = found
    packed = (passes.reception, passes.places)
    return tight_history(model, start, line, packed, record, noise, "fast", number)


class _Passes:
    """Passes over the same blocks; satellites stand at few places."""

    def __init__(
        self,
        model: TightModel,
        start: TightBelief[Any],
        line: TightLine,
        noise: TightNoise,
        of_vehicle: VehiclePasses[Any],
    ) -> None:
        self.model, self.start, self.noise, self.of_vehicle = model, start, noise, of_vehicle
        self.blocks = model.vehicle.all_blocks(line.vehicle)
        self.reception, self.places = packed_reception(line.reception)

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        return self.of_vehicle.tolerances

    def run(
        self, guess: TightBelief[Any], verdict: Said | None, rounds: int
    ) -> tuple[TightEnded, BehindRanges]:
        """Run one pass."""
        linear = self._linear(guess)
        behind = filtered_behind_ranges(self.model, self.start, linear, verdict, rounds)
        return self._ended(linear, behind), behind

    def starts(self, record: TightEnded) -> TightBelief[Any]:
        """Return where blocks start by what a pass found, batch shape (B, K)."""
        after = record.belief
        vehicle = starts_of_blocks(self.start.vehicle, after.vehicle)
        rest = (
            torch.cat((first.unsqueeze(1), later[:, :-1]), 1)
            for first, later in zip(self.start[1:], after[1:], strict=True)
        )
        return TightBelief(vehicle, *rest)

    def move(self, new: TightBelief[Any], old: TightBelief[Any]) -> float:
        """Return how far the worst block's start moved, m; clocks are linear and do not count."""
        return self.of_vehicle.move(new.vehicle, old.vehicle)

    def trusts(self, new: TightBelief[Any], old: TightBelief[Any]) -> bool:
        """Return whether a pass came near."""
        return self.of_vehicle.trusts(new.vehicle, old.vehicle)

    def detached(self, begin: TightBelief[Any]) -> TightBelief[Any]:
        """Return the same beliefs without gradients."""
        return map_tight_belief(begin, Tensor.detach)

    def _linear(self, guess: TightBelief[Any]) -> Linear:
        model, reception = self.model, self.reception
        ahead = beside_clock(
            model, guess, self.of_vehicle.ahead(guess.vehicle), reception.elapsed, self.noise
        )
        end = ahead.belief
        antenna = model.vehicle.antenna(end.vehicle, self.blocks, reception.delay)
        found = measured_ranges(antenna, end.clock, reception, self.noise)
        return Linear(
            ahead,
            self._shift(guess, ahead),
            antenna,
            found,
            variance_in_series(found, reception, self.noise),
            model.vehicle.measured(end.vehicle, self.blocks),
            self.places,
        )

    def _shift(self, guess: TightBelief[Any], ahead: TightAhead) -> Tensor:
        """Return by how much a block moves because the one before ends elsewhere, (B, K, n + c)."""
        before, blocks = map_tree((ahead.belief, self.blocks), lambda x: x[:, :-1])
        after = map_tight_belief(guess, lambda x: x[:, 1:])
        gap = torch.cat(
            (
                self.model.vehicle.difference(before.vehicle, after.vehicle, blocks),
                before.clock - after.clock,
            ),
            -1,
        )
        gap = torch.nn.functional.pad(gap, (0, 0, 1, 0))
        return (ahead.transition @ gap.unsqueeze(-1)).squeeze(-1)

    def _ended(self, linear: Linear, behind: BehindRanges) -> TightEnded:
        """Return every block's end as a pass has it."""
        model, filtered, said = self.model, behind.filtered, behind.said
        end, found, own = linear.ahead.belief, behind.found, behind.own
        unmoved = torch.zeros_like(said.ranges.anew.shift)

        def moved(mean: Tensor, covariance: Tensor, refused: Tensor, heard: Tensor) -> Any:
            belief = fed_back(model, end, mean, unmoved, self.blocks)
            belief = with_covariance(belief, covariance)
            vehicle = belief.vehicle._replace(refused=heard)
            return belief._replace(vehicle=vehicle, refused=refused)

        def earlier(first: Tensor, after: Tensor) -> Tensor:
            return torch.cat((first.unsqueeze(1), after[:, :-1]), 1)

        refused, heard = said.ranges.refused, said.own.refused
        there = found.present > 0.5
        wide = with_surprise(filtered.prior_covariance, linear.antenna)
        spread = (found.observation @ wide * found.observation).sum(-1) + found.variance
        shown = model.vehicle.rows.spread(own.present) > 0.5
        return TightEnded(
            moved(
                filtered.prior_mean,
                filtered.prior_covariance,
                earlier(self.start.refused, refused),
                earlier(self.start.vehicle.refused, heard),
            ),
            moved(filtered.mean, filtered.covariance, refused, heard),
            torch.where(shown, own.innovation, torch.nan),
            said.own,
            torch.where(there, found.innovation, torch.nan),
            torch.where(there, spread, torch.nan),
            said.ranges,
        )


def _wants_gradient(
    model: TightModel, start: TightBelief[Any], line: TightLine, noise: TightNoise
) -> bool:
    leaves: list[Tensor] = []
    map_tree((start, line.reception, line.vehicle.line, noise), lambda x: _kept(leaves, x))
    if isinstance(model.vehicle, nn.Module):
        leaves += model.vehicle.parameters()
    return wants_gradient(leaves)


def _kept(leaves: list[Tensor], leaf: Tensor) -> Tensor:
    leaves.append(leaf)
    return leaf
