"""The tightly coupled navigator: as long as one satellite is heard its range helps.

It starts itself as the loosely coupled ones do, from fixes; from there on it takes ranges and range
rates of single satellites, four or one or none. A log without fixes gets single-point ones first
(:func:`navlearn.logs.single_point_fixes.with_single_point_fixes`).
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.filters.belief import Belief
from navlearn.filters.ins_belief import InsBelief
from navlearn.filters.tight_belief import TightBelief, map_tight_belief
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import aligned_ins_belief, calibrated
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.start import aligned_belief, told_from, warn_of_level_samples
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.ins_vehicle import InsVehicle
from navlearn.fusion.tight.module import Method, TightEkf
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.mechanization.alignment import Alignment, AlignmentOptions
from navlearn.mechanization.confirmed_standstill import confirmed_standstill
from navlearn.mechanization.ins_alignment import InsAlignment, InsAlignmentOptions, align_ins
from navlearn.mechanization.track_alignment import align_riss
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample, SatelliteRanges


@dataclass(frozen=True, kw_only=True)
class TightNavigatorOptions:
    """Choices of a tightly coupled navigator.

    Attributes:
        vehicle: The car, RISS or full IMU: its model, noise and lever arm; its kinds of fixes are
            for the loosely coupled filter and mean nothing here.
        tight: Ranges and the receiver's clock.
        alignment: How it is started, of the vehicle's own kind; None takes that kind's defaults.
        method: ``fast`` or ``exact`` form of the filter, or its ``sequential`` oracle.
    """

    vehicle: EkfOptions | InsEkfOptions = field(default_factory=EkfOptions)
    tight: TightEkfOptions = field(default_factory=TightEkfOptions)
    alignment: AlignmentOptions | InsAlignmentOptions | None = None
    method: Method = "fast"

    def __post_init__(self) -> None:
        """Refuse an alignment of another kind of car.

        Raises:
            ConfigError: If that is so.
        """
        own = AlignmentOptions if isinstance(self.vehicle, EkfOptions) else InsAlignmentOptions
        if self.alignment is not None and not isinstance(self.alignment, own):
            raise ConfigError(
                f"TightNavigatorOptions.alignment: found {type(self.alignment).__name__} beside "
                f"{type(self.vehicle).__name__}; expected {own.__name__}"
            )


class TightNavigatorRun(NamedTuple):
    """A drive as the filter saw it.

    Attributes:
        first: The filter's first interval among those of the drive; what came before only served
            alignment.
        alignment: Where and with what the filter started.
        samples: The intervals from ``first`` on, shape (T,) and (T, 3) each, as the filter took
            them (:meth:`TightNavigator.prepared`).
        history: What the filter believed; its indices count from ``first``.
    """

    first: int
    alignment: Alignment | InsAlignment
    samples: RissSample | ImuSample
    history: TightHistory


class TightNavigator:
    """Tightly coupled filter of one car."""

    def __init__(self, options: TightNavigatorOptions | None = None) -> None:
        self.options = options or TightNavigatorOptions()
        chosen = self.options.vehicle
        self.vehicle: RissVehicle | InsVehicle = (
            RissVehicle(chosen) if isinstance(chosen, EkfOptions) else InsVehicle(chosen)
        )
        self._filters: dict[int, TightEkf] = {}

    def filter(self, systems: int) -> TightEkf:
        """Return the filter for so many systems of satellites, always the same one.

        Args:
            systems: Number of systems.
        """
        if systems not in self._filters:
            self._filters[systems] = TightEkf(self.vehicle, self.options.tight, systems)
        return self._filters[systems]

    def align(
        self,
        samples: RissSample | ImuSample,
        fixes: GnssFix,
        timing: FixTiming,
        *,
        bridged: Tensor | None = None,
    ) -> Alignment | InsAlignment:
        """Return the first state from which the filter can run.

        Args:
            samples: Intervals of one drive, shape (T,) and (T, 3) each.
            fixes: Its fixes, shape (M,) each.
            timing: Where the fixes fall, shape (M,) each.
            bridged: Where a gap in the IMU was bridged, bool, shape (T,); None means nowhere.

        Raises:
            LogError: The drive tells no azimuth.
            ConfigError: The samples are not those of the vehicle.
        """
        chosen, own = self.options.vehicle, self.options.alignment
        if isinstance(chosen, EkfOptions) and isinstance(samples, RissSample):
            course = own if isinstance(own, AlignmentOptions) else AlignmentOptions()
            return align_riss(samples, fixes, timing, course)
        if isinstance(chosen, InsEkfOptions) and isinstance(samples, ImuSample):
            six_axes = own if isinstance(own, InsAlignmentOptions) else InsAlignmentOptions()
            six_axes = six_axes.with_lever_arm(chosen.lever_arm)
            return align_ins(samples, fixes, timing, six_axes, bridged=bridged)
        raise ConfigError(
            f"tight navigator: found {type(samples).__name__} for a vehicle of "
            f"{type(chosen).__name__}; give RissSample to EkfOptions, ImuSample to InsEkfOptions"
        )

    def start(self, alignment: Alignment | InsAlignment) -> Belief | InsBelief:
        """Return the vehicle's belief that an alignment justifies.

        Args:
            alignment: Where and with what the filter starts.
        """
        chosen = self.options.vehicle
        if isinstance(chosen, EkfOptions) and isinstance(alignment, Alignment):
            return aligned_belief(chosen, alignment)
        if isinstance(chosen, InsEkfOptions) and isinstance(alignment, InsAlignment):
            return aligned_ins_belief(chosen, alignment)
        raise ConfigError(
            f"tight navigator: found {type(alignment).__name__} for a vehicle of "
            f"{type(chosen).__name__}; give the alignment that align() returned"
        )

    def prepared(
        self, samples: RissSample | ImuSample, alignment: Alignment | InsAlignment
    ) -> RissSample | ImuSample:
        """Return samples as the filter takes them.

        Args:
            samples: Intervals, shape (T,) and (T, 3) each.
            alignment: What alignment found: a full-IMU filter without bias states gets samples
                less the biases in it.
        """
        chosen = self.options.vehicle
        if (
            isinstance(chosen, InsEkfOptions)
            and isinstance(samples, ImuSample)
            and isinstance(alignment, InsAlignment)
        ):
            return calibrated(chosen, samples, alignment)
        return samples

    def run(
        self,
        samples: RissSample | ImuSample,
        fixes: GnssFix,
        fix_timing: FixTiming,
        ranges: SatelliteRanges,
        timing: FixTiming,
        *,
        systems: int | None = None,
        bridged: Tensor | None = None,
    ) -> TightNavigatorRun:
        """Align by fixes, then filter ranges to the end of the samples.

        Args:
            samples: Intervals of one drive, shape (T,) and (T, 3) each.
            fixes: Its fixes, shape (F,) each; for alignment alone.
            fix_timing: Where they fall, shape (F,) each.
            ranges: Its receptions, shape (M, S) each.
            timing: Where they fall, shape (M,) each.
            systems: Number of systems of satellites; None takes those that there are.
            bridged: Where a gap in the IMU was bridged, bool, shape (T,), which alignment does
                not reach across; None means nowhere.

        Returns:
            The run.

        Raises:
            LogError: The drive tells no azimuth.
            FilterDivergedError: The covariance or state is no longer finite or positive.
        """
        if isinstance(samples, ImuSample):
            samples = confirmed_standstill(samples, fixes, fix_timing)
        elif isinstance(self.options.vehicle, EkfOptions):
            warn_of_level_samples(self.options.vehicle, samples)
        alignment = self.align(samples, fixes, fix_timing, bridged=bridged)
        first = alignment.sample + 1
        rest = type(samples)(*(channel[first:] for channel in samples))
        rest = self.prepared(rest, alignment)
        if systems is None:
            systems = int(ranges.system.max()) + 1 if ranges.system.numel() else 1
        with torch.no_grad():
            history: TightHistory = self.filter(systems)(
                self.start(alignment),
                rest,
                *told_from(ranges, timing, first),
                method=self.options.method,
            )
        return TightNavigatorRun(first, alignment, rest, history)

    def filter_on(
        self,
        belief: TightBelief[Any],
        samples: RissSample | ImuSample,
        ranges: SatelliteRanges,
        timing: FixTiming,
        *,
        silence: float = 0.0,
    ) -> TightHistory:
        """Run the filter on from a belief, with what satellites are left or with none.

        Args:
            belief: Where to start, no batch axis.
            samples: Intervals, shape (T,) and (T, 3) each, as :meth:`prepared` returns them.
            ranges: Receptions, shape (M, S) each, of the satellites of the run before; M may be
                0. What an error model predicts of their errors has been taken off.
            timing: Where they fall, counted from the first of these samples, shape (M,) each.
            silence: Time from the last reception that the belief knows of to the first sample, s.

        Returns:
            What the filter believed; its indices count from the first of these samples.
        """
        systems = belief.clock.shape[-1] - 1
        with torch.no_grad():
            history: TightHistory = self.filter(systems)(
                belief,
                samples,
                ranges,
                timing,
                method=self.options.method,
                silence=samples.dt.new_tensor(silence),
            )
        return history


def tight_belief_at(history: TightHistory, block: Tensor | int) -> TightBelief[Any]:
    """Return what an unbatched filter believed after some of its blocks.

    Args:
        history: History of one drive.
        block: Index or indices of blocks, int64, shape (...).

    Returns:
        Belief, batch shape (...).
    """
    return map_tight_belief(history.belief, lambda channel: channel[block])
