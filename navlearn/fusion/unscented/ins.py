"""The loosely coupled unscented filter of a full IMU: a strapdown carries sigma points.

Points are deviations in the order of the error state; an attitude is turned by a rotation vector
and told apart by one, so that points may lie anywhere on the sphere of rotations [Crassidis2003].
``exact`` draws points at every block's start and carries them through all its samples at once;
``sequential`` draws them anew at every sample and is the oracle; ``fast`` solves for all blocks at
once.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.filters.unscented import UnscentedOptions, sigma_weights
from navlearn.fusion.ins import fast as ins_fast
from navlearn.fusion.ins.composed import has_closed_form
from navlearn.fusion.ins.drives import Method, filtered_ins_drives
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.path import ins_path_in_blocks
from navlearn.fusion.ins.recursion import InsEnded, ins_history
from navlearn.fusion.ins.timeline import InsOccasion, InsRest, InsTimeline, ins_occasion_after
from navlearn.fusion.tight.ins_vehicle import InsBlock, InsVehicle, ins_vehicle_line
from navlearn.fusion.tight.passes import InsPasses
from navlearn.fusion.tight.vehicle import VehicleLine
from navlearn.fusion.unscented.fast import run_unscented_fast
from navlearn.fusion.unscented.ins_carry import ins_carry
from navlearn.fusion.unscented.prediction import predicted_in_turn, rooted
from navlearn.fusion.unscented.recursion import end_block, run_unscented_loop
from navlearn.states import FixTiming, GnssFix, ImuSample


class InsUkf(InsVehicle):
    """Loosely coupled unscented full-IMU filter over drives, differentiable end to end.

    Takes and gives what :class:`navlearn.fusion.ins.loosely_coupled.InsEkf` does; ``log_noise`` is
    the same.
    """

    def __init__(self, options: InsEkfOptions | None = None) -> None:
        """Make the options ready.

        Args:
            options: Choices; None means the defaults. ``unscented`` None means its defaults, too.

        Raises:
            ConfigError: If feedback is open.
        """
        super().__init__(options)
        unscented = self.options.unscented or UnscentedOptions()
        self.weights = sigma_weights(unscented, self.model.layout.size)

    def forward(
        self,
        start: InsBelief,
        samples: ImuSample,
        fixes: GnssFix,
        timing: FixTiming,
        *,
        method: Method = "exact",
    ) -> InsHistory:
        """Run the filter over drives.

        Args:
            start: Belief before the first sample, batch shape (B,) or ().
            samples: Samples, shape (B, T) or (T,) each, vectors (B, T, 3) or (T, 3).
            fixes: GNSS solutions, shape (B, M) or (M,) each; M may be 0.
            timing: Where they fall among the samples.
            method: Form of the filter; ``fast`` answers with the loop over blocks where its passes
                do not converge, and for models that preintegration does not compose, as
                ``history.method`` says.

        Returns:
            History; without batch axis where the input had none.

        Raises:
            ConfigError: If the method is unknown.
            ShapeError: If a tensor has the wrong shape or type.
            LogError: If samples or fixes are not finite, not in SI units or hold what no drive can
                (see :mod:`navlearn.fusion.bounds`), or fixes are out of order or range.
            FilterDivergedError: If a state or variance is lost on the way.
        """
        return filtered_ins_drives(self.model, self.over, start, samples, fixes, timing, method)

    def over(self, start: InsBelief, line: InsTimeline, method: Method) -> InsHistory:
        """Run the filter over drives in blocks that have been looked at.

        Args:
            start: Belief before the first block, batch shape (B,).
            line: The drives in blocks.
            method: Form of the filter, as in :meth:`forward`.

        Returns:
            History.
        """
        whole, passes = ins_vehicle_line(line), 1
        ended: Any
        if method == "fast":
            carry = ins_carry(self, self.weights)
            ended, method, passes = run_unscented_fast(self, self.weights, carry, start, whole)
        else:
            in_turn = method == "sequential"
            ended = run_unscented_loop(self, self.weights, start, whole, in_turn=in_turn)
        record = InsEnded(*ended)
        inside = ins_path_in_blocks(self.model, start, record.belief, line)
        return ins_history(line, record, inside, method, passes)

    def passes(self, start: InsBelief, line: VehicleLine) -> InsPasses | None:
        """Return the passes of the fast form; None for models that preintegration does not tell."""
        if not has_closed_form(self.model):
            return None
        return _FreshPasses(self.model, start, line.line, self.noise)

    def step(self, belief: InsBelief, sample: ImuSample) -> InsBelief:
        """Predict one sample, as a car does while driving.

        Args:
            belief: Belief before the interval, batch shape (...).
            sample: The sample, shape (...) each; where cones matter, with rates and forces
                compensated (:func:`navlearn.fusion.ins.timeline.coning_compensated`).

        Returns:
            Belief after the interval.
        """
        none = GnssFix(*(torch.zeros_like(sample.dt) for _ in GnssFix._fields))
        block = _one_sample(sample, ins_occasion_after(sample, fix=none))
        after: InsBelief = predicted_in_turn(self, self.weights, rooted(belief), block).belief
        return after

    def update(
        self,
        belief: InsBelief,
        fix: GnssFix,
        sample: ImuSample,
        *,
        delay: Tensor | None = None,
        rest: InsRest | None = None,
        aided: Tensor | None = None,
        astray: Tensor | None = None,
    ) -> InsBelief:
        """Update with a fix, odometer and axle, standstill, or all at the end of an interval.

        Args:
            belief: Belief after the interval, batch shape (...).
            fix: The fix, shape (...) each; ``has_position`` and ``has_velocity`` 0 for none.
            sample: The interval's sample, shape (...) each.
            delay: End of the interval minus the fix's time, s, shape (...); None means zero.
            rest: Standstill up to now that has not been used yet; None means none.
            aided: 1.0 where odometer and axle shall be used, shape (...); None means nowhere.
            astray: 1.0 where the fix has moved otherwise than the car, shape (...), as
                :class:`navlearn.fusion.motion_watch.MotionWatch` tells; None means nowhere.

        Returns:
            Belief after the update, errors fed back.
        """
        occasion = ins_occasion_after(
            sample, fix=fix, delay=delay, rest=rest, aided=aided, astray=astray
        )
        block = _one_sample(sample, occasion)
        after: InsBelief = end_block(self, self.weights, rooted(belief), block)[0].belief
        return after


class _FreshPasses(InsPasses):
    """Passes whose sums need not settle: those of sigma points are summed up at every pass."""

    def move(self, new: InsBelief, old: InsBelief) -> float:
        """Return how far the worst block's start moved, m."""
        return ins_fast.largest_move(new, old)


def _one_sample(sample: ImuSample, occasion: InsOccasion) -> InsBlock:
    along = sample.dt.dim()
    return InsBlock(ImuSample(*(channel.unsqueeze(along) for channel in sample)), occasion)
