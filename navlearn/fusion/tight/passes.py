"""What the fast form asks of a vehicle: all blocks predicted, each time from a better guess."""

import math
from typing import NamedTuple, Protocol, TypeVar

from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion import fast
from navlearn.fusion.filter_model import FilterModel, predict_blocks
from navlearn.fusion.first_guess import first_guess
from navlearn.fusion.ins import fast as ins_fast
from navlearn.fusion.ins.fast_blocks import RenewedSums
from navlearn.fusion.ins.first_guess import first_ins_guess
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.noise import InsNoise
from navlearn.fusion.ins.timeline import InsTimeline
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.straight_lines import positions_between
from navlearn.fusion.timeline import Timeline
from navlearn.states import GnssFix

AnyBelief = TypeVar("AnyBelief", Belief, InsBelief)


class VehicleAhead(NamedTuple):
    """Blocks as predicted from a belief, with their linearisation there.

    Attributes:
        belief: Belief at the end, covariance as at the start, batch shape (...).
        transition: Φ, shape (..., n, n).
        noise: Q, shape (..., n, n).
    """

    belief: Belief | InsBelief
    transition: Tensor
    noise: Tensor


class VehiclePasses(Protocol[AnyBelief]):
    """Passes of a vehicle over the same blocks."""

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        ...

    def guess(self, fix: GnssFix) -> AnyBelief:
        """Return guesses of the beliefs at which blocks start, batch shape (B, K).

        Args:
            fix: What positions and velocities are roughly at the ends of blocks, shape (B, K) each.
        """
        ...

    def ahead(self, begin: AnyBelief) -> VehicleAhead:
        """Return all blocks predicted from guesses of the beliefs at their starts."""
        ...

    def move(self, new: AnyBelief, old: AnyBelief) -> float:
        """Return how far the worst block's start moved, m; infinite where more must follow."""
        ...

    def trusts(self, new: AnyBelief, old: AnyBelief) -> bool:
        """Return whether a pass came near enough for the gate's verdicts to hold."""
        ...


class RissPasses(NamedTuple):
    """Those of RISS; answers ``VehiclePasses``.

    Attributes:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise densities.
    """

    model: FilterModel
    start: Belief
    line: Timeline
    noise: EkfNoise

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        return fast.ROUGHLY, fast.TOLERANCE

    def guess(self, fix: GnssFix) -> Belief:
        """Return guesses of the beliefs at which blocks start: the fixes' positions, too."""
        line = self.line._replace(occasion=self.line.occasion._replace(fix=fix))
        found = first_guess(self.model, self.start, line)
        state = self.start.state
        told = positions_between(
            (state.lat, state.lon, state.height),
            fix,
            line.occasion.delay,
            line.samples.dt.sum(-1),
        ).told
        lat, lon, height = told[:, :-1].unbind(-1)
        return found._replace(state=found.state._replace(lat=lat, lon=lon, height=height))

    def ahead(self, begin: Belief) -> VehicleAhead:
        """Return all blocks predicted from guesses of the beliefs at their starts."""
        ahead = predict_blocks(
            self.model, begin, self.line.samples, self.line.acceleration, self.noise
        )
        end = begin._replace(
            state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
        )
        return VehicleAhead(end, ahead.linearised.transition, ahead.linearised.noise)

    def move(self, new: Belief, old: Belief) -> float:
        """Return how far the worst block's start moved, m."""
        return fast.largest_move(new, old)

    def trusts(self, new: Belief, old: Belief) -> bool:
        """Return whether a pass came near enough for the gate's verdicts to hold."""
        return fast.largest_move(new, old) < fast.TRUSTED


class InsPasses:
    """Those of a full IMU; answers ``VehiclePasses``."""

    def __init__(
        self, model: InsFilterModel, start: InsBelief, line: InsTimeline, noise: InsNoise
    ) -> None:
        """Sum up the samples of all blocks.

        Args:
            model: The filter; has a closed form
                (:func:`navlearn.fusion.ins.composed.has_closed_form`).
            start: Belief before the first sample, batch shape (B,).
            line: The drives in blocks.
            noise: Noise densities.
        """
        self.start, self.line = start, line
        self.blocks = RenewedSums(model, start, line.samples, noise)

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        return ins_fast.ROUGHLY, ins_fast.TOLERANCE

    def guess(self, fix: GnssFix) -> InsBelief:
        """Return guesses of the beliefs at which blocks start."""
        line = self.line._replace(occasion=self.line.occasion._replace(fix=fix))
        return first_ins_guess(self.blocks.model, self.start, line, self.blocks.sums.pre)

    def ahead(self, begin: InsBelief) -> VehicleAhead:
        """Return all blocks predicted from guesses of the beliefs at their starts."""
        ahead = self.blocks.ahead(begin)
        return VehicleAhead(ahead.end, ahead.transition, ahead.noise)

    def move(self, new: InsBelief, old: InsBelief) -> float:
        """Return how far the worst block's start moved, m; infinite before the sums are final."""
        return ins_fast.largest_move(new, old) if self.blocks.settled else math.inf

    def trusts(self, new: InsBelief, old: InsBelief) -> bool:
        """Return whether a pass came near enough for the gate's verdicts to hold."""
        return self.blocks.came_near(new, old)
