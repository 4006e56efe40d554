"""Passes of the unscented filter over the same blocks, for :mod:`navlearn.fusion.convergence`.

Means converge quadratically, covariances by a factor of about a hundred a pass. Passes of the
extended filter come first: they cost half as much, and find the way to within metres.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import SigmaWeights
from navlearn.fusion.gated_pass import Behind
from navlearn.fusion.gating import Judged
from navlearn.fusion.record import Ended, starts_of_blocks
from navlearn.fusion.tight.passes import VehiclePasses
from navlearn.fusion.tight.vehicle import Vehicle
from navlearn.fusion.unscented.fast_pass import (
    Carry,
    extended_blocks,
    filtered_blocks,
    regressed_blocks,
)
from navlearn.states import GnssFix

TOLERANCE = 1e-3
"""Largest move of a block's start in the last pass, m; the next would move a hundredth of it."""

ROUGHLY = 0.3
"""The same before passes with gradients, each of which converges too, m."""

SPREAD = 0.1
"""What a change of a covariance by all of its deviations counts for in a move, m."""

MOST_EXTENDED = 4
"""Passes of the extended filter after which those of the unscented one begin wherever it is."""


class UnscentedPasses:
    """Passes over the same blocks; answers :class:`navlearn.fusion.convergence.Passes`.

    Attributes:
        extended: How many passes of the extended filter have run.
    """

    def __init__(
        self,
        vehicle: Vehicle[Any],
        weights: SigmaWeights,
        carry: Carry,
        start: Any,
        blocks: Any,
        of_vehicle: VehiclePasses[Any],
    ) -> None:
        """Lay out what passes share.

        Args:
            vehicle: The vehicle.
            weights: Weights of the sigma points.
            carry: Carries points over blocks.
            start: Belief before the first block, batch shape (B,).
            blocks: The blocks, batch shape (B, K).
            of_vehicle: Passes of the extended filter over them.
        """
        self.vehicle, self.weights, self.carry = vehicle, weights, carry
        self.start, self.blocks, self.of_vehicle = start, blocks, of_vehicle
        self.extended = 0
        self._said: Judged | None = None

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        return ROUGHLY, TOLERANCE

    def roughly(self, fix: GnssFix) -> Any:
        """Return where blocks start by the extended filter, batch shape (B, K).

        Args:
            fix: Fixes at the ends of blocks, shape (B, K) each.
        """
        vehicle, of_vehicle = self.vehicle, self.of_vehicle
        begin = of_vehicle.guess(fix)
        for _ in range(MOST_EXTENDED):
            linear = extended_blocks(vehicle, of_vehicle.ahead(begin), begin, self.blocks)
            record, behind = filtered_blocks(vehicle, self.start, linear, self.blocks, None, 1)
            before, begin = begin, self.starts(record)
            self.extended += 1
            if of_vehicle.trusts(begin, before):
                self._said = behind.said
                break
        return begin

    def run(self, guess: Any, said: Judged | None, rounds: int) -> tuple[Ended, Behind]:
        """Run one pass."""
        linear = regressed_blocks(self.vehicle, self.weights, self.carry, guess, self.blocks)
        if said is None:
            # what the extended filter believed will do for the first pass
            said, self._said = self._said, None
        return filtered_blocks(self.vehicle, self.start, linear, self.blocks, said, rounds)

    def starts(self, record: Ended) -> Any:
        """Return where blocks start by what a pass found, batch shape (B, K)."""
        return starts_of_blocks(self.start, record.belief)

    def move(self, new: Any, old: Any) -> float:
        """Return how far blocks moved, m; a covariance that changed counts, too."""
        variance = old.covariance.diagonal(dim1=-2, dim2=-1)
        sigma = torch.where(variance > 0.0, variance, torch.inf).sqrt()
        change = (new.covariance - old.covariance).abs() / sigma.unsqueeze(-1) / sigma.unsqueeze(-2)
        return max(self.of_vehicle.move(new, old), SPREAD * float(change.detach().amax()))

    def trusts(self, new: Any, old: Any) -> bool:
        """Return whether a pass came near."""
        return self.of_vehicle.trusts(new, old)

    def detached(self, begin: Any) -> Any:
        """Return the same beliefs without gradients."""
        return map_tree(begin, Tensor.detach)
