"""The loosely coupled error-state filter: RISS mechanization corrected by GNSS.

[Noureldin2013] ch. 8, [Iqbal2020] §VI; three forms of one filter. ``sequential`` goes sample by
sample and is the oracle; ``exact`` loops over the blocks between updates and composes the samples
of each at once; ``fast`` solves for all blocks at once and iterates.
"""

from typing import Literal

import torch
from torch import Tensor, nn

from navlearn.filters.belief import Belief
from navlearn.fusion.fast import run_fast
from navlearn.fusion.filter_model import filter_model
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.noise import EkfNoise, log_noise, noise_from_log
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.recursion import predict_composed, run_loop
from navlearn.fusion.sequential import predict_in_turn
from navlearn.fusion.timeline import timeline
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, Trajectory

Method = Literal["exact", "fast", "sequential"]


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
        """
        super().__init__()
        self.options = options or EkfOptions()
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

        Args:
            start: Belief before the first sample, batch shape (B,) or ().
            samples: Samples, shape (B, T) or (T,) each.
            fixes: GNSS solutions, shape (B, M) or (M,) each; M may be 0.
            timing: Where they fall among the samples.
            method: Form of the filter.

        Returns:
            History; without batch axis where the input had none.
        """
        if samples.dt.dim() == 1:
            batched = self.forward(
                _map_belief(start, lambda x: x.unsqueeze(0)),
                RissSample(*(x.unsqueeze(0) for x in samples)),
                GnssFix(*(x.unsqueeze(0) for x in fixes)),
                FixTiming(*(x.unsqueeze(0) for x in timing)),
                method=method,
            )
            return _first(batched)
        fixes, timing = _at_least_one(fixes, timing, samples)
        line = timeline(self.model, samples, fixes, timing)
        if method == "sequential":
            return run_loop(self.model, start, line, self.noise, predict_in_turn, method)
        if method == "fast":
            done = run_fast(self.model, start, line, self.noise)
            if done is not None:
                return done
        return run_loop(self.model, start, line, self.noise, predict_composed, "exact")


def _map_belief(belief: Belief, function) -> Belief:
    return Belief(NavState(*map(function, belief.state)), *map(function, belief[1:]))


def _first(history: FilterHistory) -> FilterHistory:
    def pick(x: Tensor) -> Tensor:
        return x[0]

    entries = [pick(x) if isinstance(x, Tensor) else x for x in history]
    whole = FilterHistory(*entries)
    return whole._replace(
        prior=_map_belief(history.prior, pick),
        belief=_map_belief(history.belief, pick),
        trajectory=Trajectory(*map(pick, history.trajectory)),
    )


def _at_least_one(
    fixes: GnssFix, timing: FixTiming, samples: RissSample
) -> tuple[GnssFix, FixTiming]:
    if timing.index.shape[-1] > 0:
        return fixes, timing
    none = samples.dt.new_zeros((samples.dt.shape[0], 1))
    absent = GnssFix(*(none for _ in fixes))
    return absent, FixTiming(torch.full_like(none, -1, dtype=torch.int64), none)
