"""The navigator: with GNSS it filters, without it it mechanizes and takes predictions off.

It starts itself (alignment from course and standstill), runs the loosely coupled filter as long
as there are samples, and coasts from any belief with the sensor errors that the filter knew,
less what an error model predicts.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.errors import ConfigError
from navlearn.filters.belief import Belief, map_belief
from navlearn.frames import shift_geodetic
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import (
    corrected_motion,
    decay_over,
    odometer_acceleration,
    sensor_errors,
)
from navlearn.fusion.smoothing import SmoothedDrive, SmoothingOptions, smooth
from navlearn.fusion.start import aligned_belief, told_from, warn_of_level_samples
from navlearn.mechanization.alignment import Alignment, AlignmentOptions
from navlearn.mechanization.riss_adjoint import integrate
from navlearn.mechanization.track_alignment import align_riss
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory


@dataclass(frozen=True, kw_only=True)
class NavigatorOptions:
    """Choices of a navigator.

    Attributes:
        filter: The loosely coupled filter.
        alignment: How it is started.
        method: ``fast`` or ``exact`` form of the filter, or its ``sequential`` oracle.
    """

    filter: EkfOptions = field(default_factory=EkfOptions)
    alignment: AlignmentOptions = field(default_factory=AlignmentOptions)
    method: str = "fast"


class NavigatorRun(NamedTuple):
    """A drive as the filter saw it.

    Attributes:
        first: The filter's first interval among those of the drive; what came before only
            served alignment.
        alignment: Where and with what the filter started.
        samples: The intervals from ``first`` on, shape (T,) each.
        history: What the filter believed; its indices count from ``first``.
    """

    first: int
    alignment: Alignment
    samples: RissSample
    history: FilterHistory


class Navigator:
    """Filter and mechanization of one car."""

    def __init__(self, options: NavigatorOptions | None = None) -> None:
        self.options = options or NavigatorOptions()
        self.filter = riss_filter(self.options.filter)

    def run(self, samples: RissSample, fixes: GnssFix, timing: FixTiming) -> NavigatorRun:
        """Align, then filter to the end of the samples.

        Args:
            samples: Intervals of one drive, shape (T,) each.
            fixes: Its fixes, shape (M,) each; through an outage there simply are none.
            timing: Where the fixes fall, shape (M,) each.

        Returns:
            The run.

        Raises:
            LogError: The car never drove fast enough to align.
            FilterDivergedError: The covariance or state is no longer finite or positive.
        """
        warn_of_level_samples(self.options.filter, samples)
        alignment = align_riss(samples, fixes, timing, self.options.alignment)
        first = alignment.sample + 1
        rest = RissSample(*(channel[first:] for channel in samples))
        with torch.no_grad():
            history = self.filter(
                self.start(alignment),
                rest,
                *told_from(fixes, timing, first),
                method=self.options.method,
            )
        return NavigatorRun(first, alignment, rest, history)

    def smooth(
        self,
        run: NavigatorRun,
        fixes: GnssFix,
        timing: FixTiming,
        options: SmoothingOptions | None = None,
    ) -> SmoothedDrive:
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
            return smooth(
                self.filter,
                start,
                run.samples,
                *told_from(fixes, timing, run.first),
                run.history,
                options,
            )

    def start(self, alignment: Alignment) -> Belief:
        """Return the belief that an alignment justifies."""
        return aligned_belief(self.options.filter, alignment)

    def coast(
        self, belief: Belief, samples: RissSample, yaw_rate_error: Tensor | None = None
    ) -> Trajectory:
        """Mechanize from a belief without any measurement.

        Args:
            belief: Where to start and which sensor errors to remove, batch shape (...).
            samples: Intervals, shape (..., T) each.
            yaw_rate_error: Further error of the yaw rate to remove, as a model predicts it,
                rad/s, shape (..., T).

        Returns:
            Trajectory, shape (..., T) each.

        Raises:
            ConfigError: The filter's model has velocity states.
        """
        if self.options.filter.has_velocity_states:
            raise ConfigError(
                "coast: the Shen models carry velocity as a state, which plain mechanization "
                "cannot start from; run the filter through the outage instead"
            )
        if yaw_rate_error is not None:
            samples = samples._replace(yaw_rate=samples.yaw_rate - yaw_rate_error)
        errors = sensor_errors(self.options.filter)
        motion = corrected_motion(
            errors,
            samples,
            odometer_acceleration(samples.dt, samples.speed),
            belief.sensor.unsqueeze(-2),
            belief.anchor.unsqueeze(-2),
            decay_over(errors, torch.cumsum(samples.dt, -1)),
        )
        mechanization = self.options.filter.mechanization
        earth_rate = wgs84.EARTH_RATE if mechanization.earth_rate else 0.0
        return integrate(belief.state, motion, earth_rate, mechanization.passes)

    def filter_on(
        self, belief: Belief, samples: RissSample, yaw_rate_error: Tensor
    ) -> FilterHistory:
        """Run the filter on without fixes; unlike :meth:`coast` it still learns at standstill.

        Args:
            belief: Where to start, no batch axes.
            samples: Intervals, shape (T,) each.
            yaw_rate_error: Error of the yaw rate to remove first, rad/s, shape (T,).

        Returns:
            What the filter believed; its indices count from the first of these samples.
        """
        none = samples.dt[:0]
        with torch.no_grad():
            history: FilterHistory = self.filter(
                belief,
                samples._replace(yaw_rate=samples.yaw_rate - yaw_rate_error),
                GnssFix(*(none for _ in GnssFix._fields)),
                FixTiming(none.to(torch.int64), none),
                method=self.options.method,
            )
        return history


def belief_at(history: FilterHistory, block: Tensor | int) -> Belief:
    """Return what an unbatched filter believed after some of its blocks.

    Args:
        history: History of one drive.
        block: Index or indices of blocks, int64, shape (...).

    Returns:
        Belief, batch shape (...).
    """
    return map_belief(history.belief, lambda channel: channel[block])


def without_position_error(
    trajectory: Trajectory, along: Tensor, cross: Tensor, azimuth: Tensor
) -> Trajectory:
    """Return a trajectory with a predicted position error taken off.

    Args:
        trajectory: Solution, shape (..., T) each.
        along: Increments of its error along the azimuth, m, shape (..., T).
        cross: Increments of its error to the right of the azimuth, m, shape (..., T).
        azimuth: Azimuth in whose frame the increments are, rad, shape (..., T).

    Returns:
        Trajectory, shape (..., T) each; only positions differ.
    """
    sin, cos = torch.sin(azimuth), torch.cos(azimuth)
    east = torch.cumsum(along * sin + cross * cos, -1)
    north = torch.cumsum(along * cos - cross * sin, -1)
    lat, lon, height = shift_geodetic(
        trajectory.lat,
        trajectory.lon,
        trajectory.height,
        -east,
        -north,
        torch.zeros_like(east),
    )
    return trajectory._replace(lat=lat, lon=lon, height=height)
