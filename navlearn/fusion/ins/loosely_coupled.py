"""The loosely coupled error-state filter of a full IMU: strapdown corrected by GNSS.

[Groves2013] ch. 14, [Noureldin2013] ch. 8; forms of one filter. ``sequential`` goes sample by
sample and is the oracle; ``exact`` loops over the blocks between updates and composes the samples
of each at once; ``fast`` solves for all blocks at once and iterates.
"""

import torch
from torch import Tensor, nn

from navlearn.errors import ConfigError
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.composed import predict_ins_composed
from navlearn.fusion.ins.drives import Method as Method
from navlearn.fusion.ins.drives import filtered_ins_drives
from navlearn.fusion.ins.fast import run_ins_fast
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.model import ins_filter_model
from navlearn.fusion.ins.noise import InsNoise, ins_noise_from_log, log_ins_noise
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.recursion import InsCarried, end_ins_block, run_ins_loop
from navlearn.fusion.ins.sequential import predict_ins_in_turn, predict_ins_sample
from navlearn.fusion.ins.timeline import InsRest, InsTimeline, ins_occasion_after
from navlearn.states import FixTiming, GnssFix, ImuSample


class InsEkf(nn.Module):
    """Loosely coupled full-IMU filter over drives, differentiable end to end.

    ``log_noise`` holds the logarithms of all noise densities in the order of
    :class:`navlearn.fusion.ins.noise.InsNoise`; it is a parameter that does not ask for gradients
    until ``requires_grad_(True)``.
    """

    def __init__(self, options: InsEkfOptions | None = None) -> None:
        """Make the options ready.

        Args:
            options: Choices; None means the defaults.

        Raises:
            ConfigError: If the options ask for sigma points.
        """
        super().__init__()
        self.options = options or InsEkfOptions()
        if self.options.unscented is not None:
            raise ConfigError(
                "InsEkf: found options.unscented, which an extended filter has no use for; take "
                "InsUkf, or navlearn.fusion.filters_of.ins_filter(options)"
            )
        self.model = ins_filter_model(self.options)
        self.log_noise = nn.Parameter(log_ins_noise(self.options.noise), requires_grad=False)

    @property
    def noise(self) -> InsNoise:
        """Noise densities and deviations as they stand."""
        return ins_noise_from_log(self.log_noise)

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

        The fast form answers with the loop over blocks where its passes do not converge, for an
        open loop, and for models that preintegration does not compose.

        Args:
            start: Belief before the first sample, batch shape (B,) or ().
            samples: Samples, shape (B, T) or (T,) each, vectors (B, T, 3) or (T, 3).
            fixes: GNSS solutions, shape (B, M) or (M,) each; M may be 0.
            timing: Where they fall among the samples.
            method: Form of the filter; ``history.method`` says which ran.

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
        if method == "fast":
            history = run_ins_fast(self.model, start, line, self.noise)
            if history is not None:
                return history
        in_turn = method == "sequential"
        predict = predict_ins_in_turn if in_turn else predict_ins_composed
        name = "sequential" if in_turn else "exact"
        return run_ins_loop(self.model, start, line, self.noise, predict, name)

    def step(self, belief: InsBelief, sample: ImuSample) -> InsBelief:
        """Predict one sample, as a car does while driving.

        Args:
            belief: Belief before the interval, batch shape (...).
            sample: The sample, shape (...) each; where cones matter, with rates and forces
                compensated (:func:`navlearn.fusion.ins.timeline.coning_compensated`).

        Returns:
            Belief after the interval.
        """
        return predict_ins_sample(self.model, belief, sample, self.noise)[0]

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
                :class:`navlearn.fusion.motion_watch.MotionWatch` tells; None means nowhere: a
                belief knows no earlier fix.

        Returns:
            Belief after the update, errors fed back.
        """
        occasion = ins_occasion_after(
            sample, fix=fix, delay=delay, rest=rest, aided=aided, astray=astray
        )
        carried = InsCarried(belief, torch.zeros_like(belief.covariance[..., 0]))
        return end_ins_block(self.model, carried, occasion, self.noise)[1].belief
