"""The loosely coupled error-state filter: RISS mechanization corrected by GNSS.

[Noureldin2013] ch. 8, [Iqbal2020] §VI; three forms of one filter. ``sequential`` goes sample by
sample and is the oracle; ``exact`` loops over the blocks between updates and composes the samples
of each at once; ``fast`` solves for all blocks at once and iterates.
"""

import torch
from torch import Tensor, nn

from navlearn.errors import ConfigError
from navlearn.filters.belief import Belief
from navlearn.filters.belief import map_belief as map_belief
from navlearn.fusion.drives import Method, filtered_drives
from navlearn.fusion.fast import run_fast
from navlearn.fusion.filter_model import filter_model
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.noise import EkfNoise, log_noise, noise_from_log
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.recursion import Carried, end_block, predict_composed, run_loop
from navlearn.fusion.sequential import predict_in_turn, predict_sample
from navlearn.fusion.standstill import Rest
from navlearn.fusion.timeline import Timeline, known_acceleration, occasion_after
from navlearn.states import FixTiming, GnssFix, RissSample


class LooselyCoupledEkf(nn.Module):
    """Loosely coupled filter over drives, differentiable end to end.

    ``log_noise`` holds the logarithms of all noise densities in the order of
    :class:`navlearn.fusion.noise.EkfNoise`; it is a parameter that does not ask for gradients
    until ``requires_grad_(True)``.
    """

    def __init__(self, options: EkfOptions | None = None) -> None:
        """Make the options ready.

        Args:
            options: Choices; None means the defaults.

        Raises:
            ConfigError: If the options ask for sigma points.
        """
        super().__init__()
        self.options = options or EkfOptions()
        if self.options.unscented is not None:
            raise ConfigError(
                "LooselyCoupledEkf: found options.unscented, which an extended filter has no use "
                "for; take LooselyCoupledUkf, or navlearn.fusion.filters_of.riss_filter(options)"
            )
        self.model = filter_model(self.options)
        self.log_noise = nn.Parameter(log_noise(self.options.noise), requires_grad=False)

    @property
    def noise(self) -> EkfNoise:
        """Noise densities and deviations as they stand."""
        return noise_from_log(self.log_noise)

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

        The fast form answers with the loop over blocks where its passes do not converge, and for
        open feedback; ``history.method`` says which form ran.

        Args:
            start: Belief before the first sample, batch shape (B,) or ().
            samples: Samples, shape (B, T) or (T,) each.
            fixes: GNSS solutions, shape (B, M) or (M,) each; M may be 0.
            timing: Where they fall among the samples.
            method: Form of the filter.

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
        if method == "fast" and self.model.closed:
            history = run_fast(self.model, start, line, self.noise)
            if history is not None:
                return history
        if method == "sequential":
            return run_loop(self.model, start, line, self.noise, predict_in_turn, "sequential")
        return run_loop(self.model, start, line, self.noise, predict_composed, "exact")

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
        return predict_sample(self.model, belief, sample, push, self.noise)[0]

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
            acceleration: As in :meth:`step`; it carries the speed from the middle of the
                interval to the fix. None means a steady speed.
            astray: 1.0 where the fix has moved otherwise than the car, shape (...), as
                :class:`navlearn.fusion.motion_watch.MotionWatch` tells; None means nowhere: a
                belief knows no earlier fix.

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
        carried = Carried(belief, torch.zeros_like(belief.covariance[..., 0]))
        return end_block(self.model, carried, occasion, self.noise)[1].belief
