"""The loosely coupled unscented filter: RISS corrected by GNSS, carried by sigma points.

[Ghouneem2024] on the states of [Noureldin2013] ch. 8. ``exact`` draws points at every block's start
and carries them through all its samples at once; ``sequential`` draws them anew at every sample
and is the oracle; ``fast`` solves for all blocks at once.
"""

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.unscented import UnscentedOptions, sigma_weights
from navlearn.fusion.drives import Method, filtered_drives
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measured import Occasion
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.record import history, path_in_blocks
from navlearn.fusion.smoothed_blocks import SmoothedPass
from navlearn.fusion.standstill import Rest
from navlearn.fusion.tight.riss_vehicle import RissBlock, RissVehicle, vehicle_line
from navlearn.fusion.timeline import Timeline, known_acceleration, occasion_after
from navlearn.fusion.unscented.carry import riss_carry
from navlearn.fusion.unscented.fast import run_unscented_fast
from navlearn.fusion.unscented.prediction import predicted_in_turn, rooted
from navlearn.fusion.unscented.recursion import end_block, run_unscented_loop
from navlearn.fusion.unscented.smoothing import smoothed_by_points
from navlearn.states import FixTiming, GnssFix, RissSample


class LooselyCoupledUkf(RissVehicle):
    """Loosely coupled unscented filter over drives, differentiable end to end.

    Takes and gives what :class:`navlearn.fusion.loosely_coupled.LooselyCoupledEkf` does;
    ``log_noise`` is the same. The points know no F, so ``shen2010`` as printed and repaired are
    one filter here.
    """

    def __init__(self, options: EkfOptions | None = None) -> None:
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
        start: Belief,
        samples: RissSample,
        fixes: GnssFix,
        timing: FixTiming,
        *,
        method: Method = "exact",
    ) -> FilterHistory:
        """Run the filter over drives.

        Args:
            start: Belief before the first sample, batch shape (B,) or ().
            samples: Samples, shape (B, T) or (T,) each.
            fixes: GNSS solutions, shape (B, M) or (M,) each; M may be 0.
            timing: Where they fall among the samples.
            method: Form of the filter; ``fast`` answers with the loop over blocks where its passes
                do not converge, as ``history.method`` says.

        Returns:
            History; without batch axis where the input had none.

        Raises:
            ConfigError: If the method is unknown.
            ShapeError: If a tensor has the wrong shape or type.
            LogError: If samples or fixes are not finite or hold what no drive can (see
                :mod:`navlearn.fusion.bounds`), or fixes are out of order or range.
            FilterDivergedError: If a state or variance is lost on the way.
        """
        return filtered_drives(self.model, self.over, start, samples, fixes, timing, method)

    def over(self, start: Belief, line: Timeline, method: Method) -> FilterHistory:
        """Run the filter over drives in blocks that have been looked at.

        Args:
            start: Belief before the first block, batch shape (B,).
            line: The drives in blocks.
            method: Form of the filter, as in :meth:`forward`.

        Returns:
            History.
        """
        whole, passes = vehicle_line(line), 1
        if method == "fast":
            carry = riss_carry(self)
            record, method, passes = run_unscented_fast(self, self.weights, carry, start, whole)
        else:
            in_turn = method == "sequential"
            record = run_unscented_loop(self, self.weights, start, whole, in_turn=in_turn)
        inside = path_in_blocks(self.model, start, record.belief, line)
        return history(line, record, inside, method, passes)

    def smoothed(
        self, start: Belief, line: Timeline, history: FilterHistory
    ) -> SmoothedPass[Belief]:
        """Return beliefs smoothed over drives in blocks.

        Args:
            start: Belief before the first block, batch shape (B,).
            line: The drives in blocks.
            history: What the filter made of them.
        """
        blocks = self.all_blocks(vehicle_line(line))
        return smoothed_by_points(self, self.weights, riss_carry(self), start, blocks, history)

    def step(
        self, belief: Belief, sample: RissSample, acceleration: Tensor | None = None
    ) -> Belief:
        """Predict one sample, as a car does while driving.

        Args:
            belief: Belief before the interval, batch shape (...).
            sample: The sample, shape (...) each.
            acceleration: Forward acceleration by the odometer, m/s², shape (...); needed by the
                Shen models and by the odometer delay, else None.

        Returns:
            Belief after the interval.
        """
        push = known_acceleration(self.model, sample, acceleration)
        none = GnssFix(*(torch.zeros_like(sample.dt) for _ in GnssFix._fields))
        occasion = occasion_after(self.model, sample, fix=none, acceleration=push)
        block = _one_sample(sample, push, occasion)
        after: Belief = predicted_in_turn(self, self.weights, rooted(belief), block).belief
        return after

    def update(
        self,
        belief: Belief,
        fix: GnssFix,
        sample: RissSample,
        *,
        delay: Tensor | None = None,
        rest: Rest | None = None,
        acceleration: Tensor | None = None,
        astray: Tensor | None = None,
    ) -> Belief:
        """Update with a fix, standstill, or both at the end of an interval.

        Args:
            belief: Belief after the interval, batch shape (...).
            fix: The fix, shape (...) each; ``has_position`` and ``has_velocity`` 0 for none.
            sample: The interval's sample, shape (...) each.
            delay: End of the interval minus the fix's time, s, shape (...); None means zero.
            rest: Standstill up to now that has not been used yet; None means none.
            acceleration: As in :meth:`step`; None means a steady speed.
            astray: 1.0 where the fix has moved otherwise than the car, shape (...), as
                :class:`navlearn.fusion.motion_watch.MotionWatch` tells; None means nowhere.

        Returns:
            Belief after the update, errors fed back.
        """
        occasion = occasion_after(
            self.model,
            sample,
            fix=fix,
            delay=delay,
            rest=rest,
            acceleration=acceleration,
            astray=astray,
        )
        block = _one_sample(sample, occasion.end.acceleration, occasion)
        return end_block(self, self.weights, rooted(belief), block)[1].belief


def _one_sample(sample: RissSample, push: Tensor, occasion: Occasion) -> RissBlock:
    # what the odometer said a sample ago, by its acceleration
    before = sample._replace(speed=sample.speed - push * sample.dt)
    samples = RissSample(*(channel.unsqueeze(-1) for channel in sample))
    return RissBlock(samples, push.unsqueeze(-1), occasion, BlockEnd(before, push))
