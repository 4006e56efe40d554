"""The unscented filter with all blocks at once.

As :mod:`navlearn.fusion.fast`, but what is guessed of every block's start is mean and covariance:
sigma points are drawn from both. A pass regresses all blocks at the guess and runs one linear
filter, parallel in time, over them; where the guess is what the filter returns, that is the loop
over blocks itself. Means converge quadratically, covariances by a factor of about a hundred a pass.
A pass or two of the extended filter come first: they cost half as much, and find the way to within
metres.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import SigmaWeights
from navlearn.fusion.batch_axis import wants_gradient
from navlearn.fusion.convergence import solved
from navlearn.fusion.gated_pass import Behind
from navlearn.fusion.gating import Judged
from navlearn.fusion.record import Ended, starts_of_blocks
from navlearn.fusion.tight.passes import VehiclePasses
from navlearn.fusion.tight.vehicle import Vehicle, VehicleLine
from navlearn.fusion.unscented.fast_pass import (
    Carry,
    extended_blocks,
    filtered_blocks,
    regressed_blocks,
)

TOLERANCE = 1e-3
"""Largest move of a block's start in the last pass, m; the next would move a hundredth of it."""

ROUGHLY = 0.3
"""The same before passes with gradients, each of which converges too, m."""

SPREAD = 0.1
"""What a change of a covariance by all of its deviations counts for in a move, m."""

MOST_EXTENDED = 4
"""Passes of the extended filter after which those of the unscented one begin wherever it is."""


def run_unscented_fast(
    vehicle: Vehicle[Any], weights: SigmaWeights, carry: Carry, start: Any, line: VehicleLine
) -> tuple[Ended, int] | None:
    """Run the filter over all blocks at once.

    Args:
        vehicle: The vehicle.
        weights: Weights of the sigma points.
        carry: Carries points over all blocks.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.

    Returns:
        Every block's end, batch shape (B, K), and the number of passes; None where the vehicle has
        no passes, they did not converge, or what is believed oscillates.
    """
    of_vehicle = vehicle.passes(start, line)
    if of_vehicle is None:
        return None
    passes = _Passes(vehicle, weights, carry, start, line, of_vehicle)
    learning = torch.is_grad_enabled() and _wants_gradient(vehicle, start, line)
    with torch.no_grad():
        begin = passes.roughly()
    found = solved(begin, passes, learning)
    return None if found is None else (found[0], found[1] + passes.extended)


class _Passes:
    """Passes over the same blocks."""

    def __init__(
        self,
        vehicle: Vehicle[Any],
        weights: SigmaWeights,
        carry: Carry,
        start: Any,
        line: VehicleLine,
        of_vehicle: VehiclePasses[Any],
    ) -> None:
        self.vehicle, self.weights, self.carry = vehicle, weights, carry
        self.start, self.line, self.of_vehicle = start, line, of_vehicle
        self.blocks = vehicle.all_blocks(line)
        self.extended = 0
        self.first: Judged | None = None

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        return ROUGHLY, TOLERANCE

    def roughly(self) -> Any:
        """Return where blocks start by the extended filter."""
        vehicle, start = self.vehicle, self.start
        begin = self.of_vehicle.guess(self.line.line.occasion.fix)
        for _ in range(MOST_EXTENDED):
            linear = extended_blocks(vehicle, self.of_vehicle.ahead(begin), begin, self.blocks)
            record, behind = filtered_blocks(vehicle, start, linear, self.blocks, self.first, 1)
            new = self.starts(record)
            self.extended += 1
            near = self.of_vehicle.trusts(new, begin)
            begin = new
            if near:
                self.first = behind.said
                break
        return begin

    def run(self, guess: Any, said: Judged | None, rounds: int) -> tuple[Ended, Behind]:
        """Run one pass."""
        linear = regressed_blocks(self.vehicle, self.weights, self.carry, guess, self.blocks)
        if said is None:
            said, self.first = self.first, None
        return filtered_blocks(self.vehicle, self.start, linear, self.blocks, said, rounds)

    def starts(self, record: Ended) -> Any:
        """Return where blocks start by what a pass found, batch shape (B, K)."""
        return starts_of_blocks(self.start, record.belief)

    def move(self, new: Any, old: Any) -> float:
        """Return how far blocks moved, m; a covariance that changed counts, too."""
        variance = old.covariance.diagonal(dim1=-2, dim2=-1)
        sigma = torch.where(variance > 0.0, variance, torch.inf).sqrt()
        change = (new.covariance - old.covariance).abs() / sigma.unsqueeze(-1) / sigma.unsqueeze(-2)
        spread = SPREAD * float(change.detach().amax())
        return max(self.of_vehicle.move(new, old), spread)

    def trusts(self, new: Any, old: Any) -> bool:
        """Return whether a pass came near."""
        return self.of_vehicle.trusts(new, old)

    def detached(self, begin: Any) -> Any:
        """Return the same beliefs without gradients."""
        return map_tree(begin, Tensor.detach)


def _wants_gradient(vehicle: Vehicle[Any], start: Any, line: VehicleLine) -> bool:
    leaves: list[Tensor] = []

    def kept(leaf: Tensor) -> Tensor:
        leaves.append(leaf)
        return leaf

    map_tree((start, line.line), kept)
    if isinstance(vehicle, torch.nn.Module):
        leaves += vehicle.parameters()
    return wants_gradient(leaves)
