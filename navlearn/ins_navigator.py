"""The navigator of a full IMU: with GNSS it filters, without it a strapdown runs on.

It starts itself (levelling and course, or velocity matching), runs the loosely coupled filter as
long as there are samples, and coasts from any belief with the sensor errors that the filter knew.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.fusion.filters_of import ins_filter
from navlearn.fusion.ins.drives import Method
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.layout import ins_layout
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.smoothing import SmoothedInsDrive, smooth_ins
from navlearn.fusion.ins.start import aligned_ins_belief, calibrated
from navlearn.fusion.smoothing import SmoothingOptions
from navlearn.fusion.start import told_from
from navlearn.mechanization.confirmed_standstill import confirmed_standstill
from navlearn.mechanization.ins_alignment import InsAlignment, InsAlignmentOptions, align_ins
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState


@dataclass(frozen=True, kw_only=True)
class InsNavigatorOptions:
    """Choices of a full-IMU navigator.

    Attributes:
        filter: The loosely coupled filter, unscented where it names sigma points; its lever arm
            is also that of alignment.
        alignment: How it is started.
        method: ``fast`` or ``exact`` form of the filter, or its ``sequential`` oracle.
    """

    filter: InsEkfOptions = field(default_factory=InsEkfOptions)
    alignment: InsAlignmentOptions = field(default_factory=InsAlignmentOptions)
    method: Method = "fast"


class InsNavigatorRun(NamedTuple):
    """A drive as the filter saw it.

    Attributes:
        first: The filter's first interval among those of the drive; what came before only
            served alignment.
        alignment: Where and with what the filter started.
        samples: The intervals from ``first`` on, shape (T,) and (T, 3) each; standing still only
            where no fix contradicts it, and for a filter without bias states less the biases that
            alignment found.
        history: What the filter believed; its indices count from ``first``.
    """

    first: int
    alignment: InsAlignment
    samples: ImuSample
    history: InsHistory


class InsNavigator:
    """Filter and strapdown of one car."""

    def __init__(self, options: InsNavigatorOptions | None = None) -> None:
        self.options = options or InsNavigatorOptions()
        self.filter = ins_filter(self.options.filter)
        self.layout = ins_layout(self.options.filter)

    def align(
        self,
        samples: ImuSample,
        fixes: GnssFix,
        timing: FixTiming,
        *,
        bridged: Tensor | None = None,
    ) -> InsAlignment:
        """Return the first state from which the filter can run.

        Args:
            samples: Intervals of one drive, shape (T,) and (T, 3) each.
            fixes: Its fixes, shape (M,) each.
            timing: Where the fixes fall, shape (M,) each.
            bridged: Where a gap in the IMU was bridged, bool, shape (T,); None means nowhere.

        Raises:
            LogError: The drive tells no attitude.
        """
        arm = self.options.filter.lever_arm
        options = self.options.alignment.with_lever_arm(arm)
        return align_ins(samples, fixes, timing, options, bridged=bridged)

    def run(
        self,
        samples: ImuSample,
        fixes: GnssFix,
        timing: FixTiming,
        *,
        alignment: InsAlignment | None = None,
        bridged: Tensor | None = None,
    ) -> InsNavigatorRun:
        """Align, then filter to the end of the samples.

        Args:
            samples: Intervals of one drive, shape (T,) and (T, 3) each.
            fixes: Its fixes, shape (M,) each; through an outage there simply are none.
            timing: Where the fixes fall, shape (M,) each.
            alignment: Where to start; None finds it.
            bridged: Where a gap in the IMU was bridged, bool, shape (T,), which alignment does
                not reach across; None means nowhere.

        Returns:
            The run.

        Raises:
            LogError: The drive tells no attitude.
            FilterDivergedError: The covariance or state is no longer finite or positive.
        """
        samples = confirmed_standstill(samples, fixes, timing)
        if alignment is None:
            alignment = self.align(samples, fixes, timing, bridged=bridged)
        first = alignment.sample + 1
        rest = ImuSample(*(channel[first:] for channel in samples))
        rest = calibrated(self.options.filter, rest, alignment)
        with torch.no_grad():
            history = self.filter(
                self.start(alignment),
                rest,
                *told_from(fixes, timing, first),
                method=self.options.method,
            )
        return InsNavigatorRun(first, alignment, rest, history)

    def smooth(
        self,
        run: InsNavigatorRun,
        fixes: GnssFix,
        timing: FixTiming,
        options: SmoothingOptions | None = None,
    ) -> SmoothedInsDrive:
        """Smooth a whole run: the best that a drive can tell of itself, afterwards.

        Args:
            run: What :meth:`run` returned.
            fixes: The fixes that it was given, shape (M,) each.
            timing: Where they fall, shape (M,) each.
            options: How drives are smoothed; None means the defaults.

        Returns:
            The smoothed drive; its indices count from the run's first interval.
        """
        start = self.start(run.alignment)
        with torch.no_grad():
            return smooth_ins(
                self.filter,
                start,
                run.samples,
                *told_from(fixes, timing, run.first),
                run.history,
                options,
            )

    def start(self, alignment: InsAlignment) -> InsBelief:
        """Return the belief that an alignment justifies.

        Args:
            alignment: Where and with what the filter starts.
        """
        return aligned_ins_belief(self.options.filter, alignment)

    def coast(self, belief: InsBelief, samples: ImuSample) -> InsState:
        """Run the strapdown from a belief without any measurement.

        Args:
            belief: Where to start and which sensor errors to remove, batch shape (...).
            samples: Intervals, shape (..., T) and (..., T, 3) each.

        Returns:
            Solution at the end of every interval, shape (..., T) each.
        """
        bias = self._biases(belief.sensor, samples.dt)
        scale = belief.sensor if self.layout.has_scale else None
        return strapdown_over_time(
            belief.state,
            samples,
            gyro_bias=None if bias is None else bias[..., :3],
            accel_bias=None if bias is None else bias[..., 3:],
            gyro_scale=None if scale is None else scale[..., 6:9],
            accel_scale=None if scale is None else scale[..., 9:12],
        )

    def filter_on(self, belief: InsBelief, samples: ImuSample) -> InsHistory:
        """Run the filter on without fixes; unlike :meth:`coast` it still hears odometer and rest.

        Args:
            belief: Where to start, no batch axes.
            samples: Intervals, shape (T,) and (T, 3) each.

        Returns:
            What the filter believed; its indices count from the first of these samples.
        """
        none = samples.dt[:0]
        with torch.no_grad():
            history: InsHistory = self.filter(
                belief,
                samples,
                GnssFix(*(none for _ in GnssFix._fields)),
                FixTiming(none.to(torch.int64), none),
                method=self.options.method,
            )
        return history

    def _biases(self, sensor: Tensor, dt: Tensor) -> Tensor | None:
        """Return what the filter takes off gyros and accelerometers at every sample."""
        if not self.layout.has_bias:
            return None
        if math.isinf(self.options.filter.correlation_time):
            return sensor[..., :6]
        elapsed = torch.cumsum(dt, -1) - dt
        left = torch.exp(-elapsed / self.options.filter.correlation_time)
        return sensor[..., None, :6] * left.unsqueeze(-1)


def ins_belief_at(history: InsHistory, block: Tensor | int) -> InsBelief:
    """Return what an unbatched filter believed after some of its blocks.

    Args:
        history: History of one drive.
        block: Index or indices of blocks, int64, shape (...).

    Returns:
        Belief, batch shape (...).
    """
    return map_ins_belief(history.belief, lambda channel: channel[block])
