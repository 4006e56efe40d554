"""The tightly coupled error-state filter: a vehicle corrected by ranges of single satellites.

[Iqbal2020] §IX, [Groves2013] §14.3.2; forms of one filter. ``sequential`` predicts sample by sample
and is the oracle; ``exact`` loops over the blocks between receptions and composes the samples of
each at once; ``fast`` solves for all blocks at once and iterates. Any number of satellites does,
none included. A vehicle whose options name sigma points makes the filter an unscented one.
"""

from typing import Any, Literal

import torch
from torch import Tensor, nn

from navlearn.errors import ConfigError, ShapeError
from navlearn.filters.tight_belief import TightBelief, map_tight_belief, map_tree
from navlearn.fusion.batch_axis import first, unsqueezed
from navlearn.fusion.tight.checks import check_tight_history, check_tight_inputs
from navlearn.fusion.tight.fast import run_tight_fast
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.model import tight_model
from navlearn.fusion.tight.noise import TightNoise, log_tight_noise, tight_noise_from_log
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.packing import packed_reception
from navlearn.fusion.tight.prediction import predicted_belief
from navlearn.fusion.tight.recursion import run_tight_loop
from navlearn.fusion.tight.start import tight_start
from navlearn.fusion.tight.steps import LINEAR
from navlearn.fusion.tight.timeline import Reception, tight_timeline, usable, with_system_each
from navlearn.fusion.tight.update import updated
from navlearn.fusion.tight.vehicle import Vehicle
from navlearn.fusion.unscented.tight import unscented_steps
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample, SatelliteRanges

Method = Literal["exact", "fast", "sequential"]


class TightEkf(nn.Module):
    """Tightly coupled filter over drives, differentiable end to end.

    ``log_noise`` holds the logarithms of the noise of ranges and clock in the order of
    :func:`navlearn.fusion.tight.noise.log_tight_noise`; it is a parameter that does not ask for
    gradients until ``requires_grad_(True)``. The vehicle has its own.
    """

    def __init__(
        self, vehicle: Vehicle[Any], options: TightEkfOptions | None = None, systems: int = 1
    ) -> None:
        """Make the options ready.

        Args:
            vehicle: What carries the antenna.
            options: Choices beside those of the vehicle; None means the defaults.
            systems: Number of satellite systems, each with its own time.

        Raises:
            ConfigError: If there is no system.
        """
        super().__init__()
        if systems < 1:
            raise ConfigError(
                f"tight filter: found {systems} satellite systems; expected 1 or more"
            )
        self.options = options or TightEkfOptions()
        self.vehicle = vehicle
        self.model = tight_model(vehicle, self.options, systems)
        unscented = vehicle.unscented
        self.steps = LINEAR if unscented is None else unscented_steps(self.model, unscented)
        self.log_noise = nn.Parameter(log_tight_noise(self.options), requires_grad=False)

    @property
    def noise(self) -> TightNoise:
        """Noise of ranges and clock as it stands."""
        return tight_noise_from_log(self.log_noise)

    def start(self, vehicle: Any, satellites: int) -> TightBelief[Any]:
        """Return a belief of a vehicle with a clock of which nothing is known.

        Args:
            vehicle: Belief of the vehicle, batch shape (...).
            satellites: Number S of satellites.

        Returns:
            Belief, batch shape (...).
        """
        return tight_start(self.model, vehicle, satellites)

    def forward(
        self,
        start: Any,
        samples: RissSample | ImuSample,
        ranges: SatelliteRanges,
        timing: FixTiming,
        *,
        fixes: GnssFix | None = None,
        method: Method = "exact",
        silence: Tensor | None = None,
    ) -> TightHistory:
        """Run the filter over drives.

        Args:
            start: Belief before the first sample, batch shape (B,) or (): a ``TightBelief``, or
                one of the vehicle alone, whose clock is then unknown.
            samples: Samples, batch shape (B, T) or (T,).
            ranges: Ranges, shape (B, M, S) or (M, S) each; M may be 0.
            timing: Where the receptions fall among the samples, shape (B, M) or (M,).
            fixes: Fixes at the same moments, for vehicles that take them; None for none.
            method: Form of the filter; ``history.method`` says which ran. The fast form answers
                with the loop over blocks where its passes do not converge, and for vehicles that
                have no such form or are unscented.
            silence: Time from the last reception that ``start`` knows of to the first sample's
                beginning, s, shape (B,) or (), as multipath lasts; None where there was none.

        Returns:
            History; without batch axis where the input had none.

        Raises:
            ConfigError: If the method is unknown.
            ShapeError: If a tensor has the wrong shape or type.
            LogError: If samples, ranges or fixes are not finite where they are used, not in SI
                units or radians, or out of order or range.
            FilterDivergedError: If a state or variance is lost on the way.
        """
        if method not in ("exact", "fast", "sequential"):
            raise ConfigError(
                f"tight filter: found method {method!r}; choose exact, fast or sequential"
            )
        if not isinstance(start, TightBelief):
            start = self.start(start, ranges.has_range.shape[-1])
        if samples.dt.dim() == 1:
            batched = self.forward(
                map_tight_belief(start, unsqueezed),
                type(samples)(*map(unsqueezed, samples)),
                SatelliteRanges(*map(unsqueezed, ranges)),
                FixTiming(*map(unsqueezed, timing)),
                fixes=None if fixes is None else GnssFix(*map(unsqueezed, fixes)),
                method=method,
                silence=silence,
            )
            alone: TightHistory = map_tree(batched, first)
            return alone
        if samples.dt.dim() != 2 or samples.dt.shape[-1] == 0:
            raise ShapeError(
                f"tight filter: samples have shape {tuple(samples.dt.shape)}; expected (B, T) or "
                "(T,) with at least one sample"
            )
        ranges = with_system_each(ranges)
        check_tight_inputs(self.model, start, samples, ranges, timing, fixes)
        line = tight_timeline(self.model, samples, ranges, timing, fixes, silence)
        history = None
        if method == "fast" and self.vehicle.unscented is None:
            history = run_tight_fast(self.model, start, line, self.noise)
        if history is None:
            in_turn = method == "sequential"
            history = run_tight_loop(
                self.model, start, line, self.noise, in_turn=in_turn, steps=self.steps
            )
        check_tight_history(self.model, history, samples)
        return history

    def step(self, belief: TightBelief[Any], samples: RissSample | ImuSample) -> TightBelief[Any]:
        """Predict a stretch of samples, as a car does while driving.

        Args:
            belief: Belief before them, batch shape (B,).
            samples: Samples, batch shape (B, n): one, or all since the last reception; about a
                second at most.

        Returns:
            Belief after them.
        """
        block = self._block(samples)
        ahead = self.steps.ahead(self.model, belief, block, samples.dt.sum(-1), self.noise)
        return predicted_belief(ahead, belief.covariance)

    def update(
        self,
        belief: TightBelief[Any],
        ranges: SatelliteRanges,
        samples: RissSample | ImuSample,
        *,
        delay: Tensor | None = None,
    ) -> TightBelief[Any]:
        """Update with ranges at the end of a stretch of samples.

        What the vehicle measures of itself, standstill among it, is taken from these samples: each
        must be given once.

        Args:
            belief: Belief after the samples, batch shape (B,).
            ranges: Ranges of one reception, shape (B, S) each.
            samples: The samples up to the reception since the last, batch shape (B, n).
            delay: End of the last sample minus the time of reception, s, shape (B,); None for zero.

        Returns:
            Belief after the update, errors fed back.
        """
        late = torch.zeros_like(samples.dt[:, 0]) if delay is None else delay
        elapsed = samples.dt.sum(-1)
        reception = Reception(usable(self.options, ranges), late, elapsed, elapsed)
        heard, places = packed_reception(reception)
        block = self._block(samples)
        see = self.steps.see
        return updated(self.model, belief, block, heard, places, self.noise, see).belief

    def _block(self, samples: RissSample | ImuSample) -> Any:
        """Return a stretch of samples as one block that ends with a reception."""
        dt = samples.dt
        last = torch.full_like(dt[:, :1], dt.shape[-1] - 1, dtype=torch.int64)
        line = self.vehicle.laid_out(samples, None, FixTiming(last, torch.zeros_like(dt[:, :1])))
        if line.blocks.end.shape[-1] != 1:
            raise ShapeError(
                f"tight filter: a stretch of {float(dt.sum(-1).amax()):.2f} s makes "
                f"{line.blocks.end.shape[-1]} blocks; expected one: give shorter stretches, or a "
                "longer max_block"
            )
        return self.vehicle.block(line, 0)
