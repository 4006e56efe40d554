"""Runs of the tightly coupled filter: up to an outage's start, made once, and on from there.

What lies before an outage is the same whichever satellites stay visible, so it is filtered once.
"""

import hashlib
from typing import NamedTuple

import numpy as np
import torch

from navlearn.experiment.baselines import filter_options
from navlearn.experiment.drive import timeline_of
from navlearn.experiment.ins_filter_runs import imu_timeline_of, ins_filter_options
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_timeline import ImuTimeline
from navlearn.logs.range_tensors import RangeSeries, ranges_of
from navlearn.logs.resample import RissTimeline
from navlearn.mechanization.confirmed_standstill import confirmed_standstill
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.ingredients import ingredients_of
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample, SatelliteRanges
from navlearn.tight_navigator import (
    TightNavigator,
    TightNavigatorOptions,
    TightNavigatorRun,
    tight_belief_at,
)

Line = RissTimeline | ImuTimeline

TIGHT = ("tc_ekf", "tc_ukf")
"""Tightly coupled filters without a model, by name."""


class TightStart(NamedTuple):
    """A drive filtered up to an outage's start, and what is known from there on.

    Attributes:
        line: The whole known log as tensors.
        series: Its ranges; satellites keep their slots before and after the start.
        navigator: What ran.
        run: The run over what lies before the start.
        samples: Samples from the start on.
        ranges: Receptions from the start on, of the satellites that stay visible.
        timing: Where they fall, counted from the first of ``samples``.
        t: Ends of ``samples``, s.
    """

    line: Line
    series: RangeSeries
    navigator: TightNavigator
    run: TightNavigatorRun
    samples: RissSample | ImuSample
    ranges: SatelliteRanges
    timing: FixTiming
    t: torch.Tensor

    @property
    def received(self) -> torch.Tensor:
        """When the receptions of ``ranges`` were, s, shape (M,)."""
        return self.series.t[len(self.series.t) - len(self.timing.index) :]

    def through(self, ranges: SatelliteRanges | None = None) -> TightHistory:
        """Return the filter's run from the start on.

        Args:
            ranges: The receptions as an error model corrected them; None takes them as they are.
        """
        chosen = self.ranges if ranges is None else ranges
        history = self.run.history
        heard = history.end[history.reception >= 0]
        silence = torch.inf
        if len(heard):
            silence = float(self.run.samples.dt[int(heard[-1]) + 1 :].sum())
        return self.navigator.filter_on(
            tight_belief_at(history, -1), self.samples, chosen, self.timing, silence=silence
        )


class TightFilterRuns:
    """Runs of the tightly coupled filter, by what they were made from."""

    def __init__(self, recipe: Recipe) -> None:
        """Make an empty store of runs.

        Args:
            recipe: The recipe.
        """
        self.recipe = recipe
        self._made: dict[str, tuple[TightNavigator, TightNavigatorRun]] = {}

    def run(
        self, log: DriveLog, method: str = "tc_ekf"
    ) -> tuple[Line, RangeSeries, TightNavigator, TightNavigatorRun]:
        """Return timeline, ranges, navigator and run of a whole log.

        Args:
            log: The log.
            method: Which filter: ``tc_ekf`` or ``tc_ukf``.
        """
        line = self._line(log)
        series = range_series(log, line)
        navigator, run = self._run(log, line, series, len(line.t), method)
        return line, series, navigator, run

    def before(self, log: DriveLog, outage: Outage, method: str = "tc_ekf") -> TightStart:
        """Return the run up to an outage's start, and what is known from there on.

        Args:
            log: The drive up to the outage's end, without fixes from its start, and from there
                without ranges but those of the satellites that stay visible.
            outage: The outage.
            method: Which filter: ``tc_ekf`` or ``tc_ukf``.
        """
        line = self._line(log)
        series = range_series(log, line)
        first = _first_after(line, series, outage)
        navigator, run = self._run(log, line, series, first, method)
        later = series.timing.index >= first
        samples = line.samples
        if isinstance(samples, ImuSample):
            samples = confirmed_standstill(samples, line.fixes, line.timing)
        kept = type(samples)(*(channel[first:] for channel in samples))
        return TightStart(
            line,
            series,
            navigator,
            run,
            navigator.prepared(kept, run.alignment),
            receptions(series.ranges, later),
            FixTiming(series.timing.index[later] - first, series.timing.delay[later]),
            line.t[first:],
        )

    def _line(self, log: DriveLog) -> Line:
        if self.recipe.mechanization.sensors == "imu":
            return imu_timeline_of(log, self.recipe)
        return timeline_of(log, self.recipe)

    def _run(
        self,
        log: DriveLog,
        line: Line,
        series: RangeSeries,
        last: int,
        method: str,
    ) -> tuple[TightNavigator, TightNavigatorRun]:
        """Return navigator and run over the first intervals of a log."""
        early, heard = line.timing.index < last, series.timing.index < last
        samples = type(line.samples)(*(channel[:last] for channel in line.samples))
        fixes = GnssFix(*(channel[early] for channel in line.fixes))
        fix_timing = FixTiming(*(channel[early] for channel in line.timing))
        ranges = receptions(series.ranges, heard)
        timing = FixTiming(*(channel[heard] for channel in series.timing))
        options = tight_navigator_options(self.recipe, log, method)
        bridged = line.bridged[:last] if isinstance(line, ImuTimeline) else None
        channels = (*samples, *fixes, *fix_timing, *ranges, *timing)
        channels += () if bridged is None else (bridged,)
        key = _key(repr(options), series.satellites, channels)
        if key not in self._made:
            navigator = TightNavigator(options)
            run = navigator.run(
                samples,
                fixes,
                fix_timing,
                ranges,
                timing,
                systems=len(series.systems),
                bridged=bridged,
            )
            self._made[key] = (navigator, run)
        return self._made[key]


def _first_after(line: Line, series: RangeSeries, outage: Outage) -> int:
    """Return the first interval that depends on which satellites stay.

    A reception is used at the nearest end of an interval: one soon after the start perhaps at an
    end before it, which then belongs to the outage, and one just before the start perhaps at an
    end after it, which then does not.
    """
    first = int(torch.searchsorted(line.t, outage.start - 1e-9))
    inside = series.t >= outage.start
    whole, partial = series.timing.index[~inside], series.timing.index[inside]
    if len(whole):
        first = max(first, int(whole[-1]) + 1)
    return min(first, int(partial[0])) if len(partial) else first


def receptions(ranges: SatelliteRanges, chosen: torch.Tensor) -> SatelliteRanges:
    """Return some of the receptions of a drive.

    Args:
        ranges: Receptions, shape (M, S) each.
        chosen: Which, bool, shape (M,).
    """
    kept = {
        name: getattr(ranges, name)[chosen] for name in SatelliteRanges._fields if name != "system"
    }
    return ranges._replace(**kept)


def range_series(log: DriveLog, line: Line) -> RangeSeries:
    """Return the ranges of a log on the grid of its samples.

    Args:
        log: The log.
        line: The log as tensors.

    Raises:
        LogError: It has no ranges.
    """
    return ranges_of(log, np.concatenate(([line.start_time], line.t.numpy())))


def tight_navigator_options(
    recipe: Recipe, log: DriveLog, method: str = "tc_ekf"
) -> TightNavigatorOptions:
    """Return the options of a recipe's tightly coupled navigator.

    Args:
        recipe: Its ``filter`` or ``ins_filter`` tells of the vehicle, ``tight`` of the ranges.
        log: Tells the lever arm of the antenna where the recipe does not.
        method: ``tc_ekf`` linearises, ``tc_ukf`` takes sigma points.
    """
    kind = "ukf" if ingredients_of(method).unscented else "ekf"
    vehicle: EkfOptions | InsEkfOptions = filter_options(recipe, kind, log)
    if recipe.mechanization.sensors == "imu":
        vehicle = ins_filter_options(recipe, f"ins_{kind}", log)
    tight: TightEkfOptions = recipe.tight_ekf_options()
    return TightNavigatorOptions(vehicle=vehicle, tight=tight)


def _key(options: str, satellites: tuple[str, ...], channels: tuple[torch.Tensor, ...]) -> str:
    digest = hashlib.sha256(f"{options}{satellites}".encode())
    for channel in channels:
        digest.update(f"{tuple(channel.shape)}".encode())
        digest.update(channel.contiguous().numpy().tobytes())
    return digest.hexdigest()
