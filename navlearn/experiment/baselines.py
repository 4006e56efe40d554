"""The methods that learn nothing: dead reckoning, and the filter with and without a gyro bias."""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
import torch

from navlearn.experiment.drive import timeline_of
from navlearn.experiment.filter_runs import MadeRun, made_run
from navlearn.experiment.solution_tables import solution_table, with_deviations
from navlearn.fusion.dead_reckoning import DeadReckoningOptions, dead_reckoning_start
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.options import EkfOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.navigator import Navigator, NavigatorOptions, NavigatorRun
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.outages.store import log_fingerprint
from navlearn.recipe import Recipe
from navlearn.states import RissSample, Trajectory

PLAIN: dict[str, Literal["bias_free", "shen2010"]] = {
    "ekf_plain": "bias_free",
    "ekf_shen2010": "shen2010",
    "ekf_ghouneem2024": "shen2010",
}
"""Methods that are the filter with another error model."""

UNGATED = ("ekf_ghouneem2024",)
"""Methods that believe every measurement."""


def filter_options(recipe: Recipe, method: str = "ekf", log: DriveLog | None = None) -> EkfOptions:
    """Return the filter options of a method: the recipe's, for every method alike.

    Args:
        recipe: The recipe.
        method: ``ekf_plain`` takes the gyro bias away, other names add their ingredients; every
            name without any is the honest filter.
        log: Tells the lever arm of the antenna, and whether fixes have a vertical velocity, where
            the recipe does not.
    """
    options = recipe.ekf_options(method)
    if log is not None and "lever_arm" not in recipe.filter:
        options = replace(options, lever_arm=log.metadata.lever_arm)
    if log is not None and "vertical_velocity" not in recipe.filter:
        told = "v_u" in log.fixes and bool(log.fixes["v_u"].notna().any())
        options = replace(options, vertical_velocity=told)
    mechanization = replace(options.mechanization, dimensions=recipe.mechanization.dims)
    options = replace(options, mechanization=mechanization)
    if method in UNGATED:
        options = replace(options, gate=GateOptions(probability=1.0))
    return replace(options, model=PLAIN[method]) if method in PLAIN else options


class FilterRuns:
    """Filter runs over known logs, made once and shared by the methods."""

    def __init__(self, recipe: Recipe, *, growing: bool = False) -> None:
        """Make an empty store of runs.

        Args:
            recipe: The recipe.
            growing: Whether a run goes on from that over the last log, as far as both logs are
                the same. Faster by a factor of three; positions then differ in the seventh
                digit of a metre, and depend that little on which logs came before.
        """
        self.recipe, self.growing = recipe, growing
        self._made: dict[tuple[str, str], MadeRun] = {}
        self._latest: dict[tuple[str, str], MadeRun] = {}

    def run(
        self, log: DriveLog, options: EkfOptions | None = None, *, series: str = ""
    ) -> tuple[RissTimeline, Navigator, NavigatorRun]:
        """Return timeline, navigator and run of a log.

        Args:
            log: The drive up to an outage's end, without fixes from its start.
            options: Which filter; None is the recipe's honest one.
            series: Name of the logs that begin alike: what a method made of each known log does
                not begin like the logs themselves.
        """
        chosen = filter_options(self.recipe, log=log) if options is None else options
        # By what is in it: a log that lacks one more fix must not get the run of another. Raw
        # ranges are nothing to this filter, whichever satellites stay.
        key = (repr(chosen), log_fingerprint(replace(log, ranges=None)))
        alike = (key[0], series)
        if key not in self._made:
            navigator = Navigator(NavigatorOptions(filter=chosen))
            timeline = timeline_of(log, self.recipe)
            earlier = self._latest.get(alike) if self.growing else None
            made = made_run(navigator, timeline, earlier)
            self._made[key] = self._latest[alike] = made
        return self._made[key]


class FilterMethod:
    """The filter through the outage: it predicts with all that it has estimated."""

    def __init__(self, runs: FilterRuns, method: str) -> None:
        self.runs, self.method = runs, method

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the filter's prediction through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        options = filter_options(self.runs.recipe, self.method, log)
        timeline, _, run = self.runs.run(log, options)
        return Solution(
            table=believed_table(timeline.t[run.first :], believed(run.history), outage)
        )


class DeadReckoning:
    """Last fix, last course, last known bias; then the mechanization alone."""

    def __init__(self, recipe: Recipe, options: DeadReckoningOptions | None = None) -> None:
        self.recipe, self.options = recipe, options or DeadReckoningOptions()
        self.mechanization = filter_options(recipe).mechanization

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return dead reckoning through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        timeline = timeline_of(log, self.recipe)
        arm = filter_options(self.recipe, log=log).lever_arm
        options = replace(self.options, lever_arm=arm)
        start = dead_reckoning_start(timeline.samples, timeline.fixes, timeline.timing, options)
        after = slice(start.sample + 1, None)
        trajectory = riss_over_time(
            start.state,
            RissSample(*(channel[after] for channel in timeline.samples)),
            start.gyro_bias,
            start.odometer_scale,
            options=self.mechanization,
        )
        return Solution(
            table=solution_table(timeline.t[after], trajectory, outage),
            notes={
                "gyro_bias_deg_per_h": float(np.degrees(start.gyro_bias.item())) * 3600.0,
                "odometer_scale": float(start.odometer_scale),
            },
        )


class Believed(NamedTuple):
    """A filter's solution over a drive, and how sure it is of its position.

    Attributes:
        trajectory: Solution, shape (T,) each.
        end: Samples at which the covariance is known, int64, shape (K,).
        covariance: Of the position error east and north, m², shape (K, 2, 2).
    """

    trajectory: Trajectory
    end: torch.Tensor
    covariance: torch.Tensor


def believed(history: FilterHistory) -> Believed:
    """Return the solution that a filter's history holds.

    Args:
        history: History of one drive.
    """
    return Believed(
        history.trajectory, history.end, history.belief.covariance[..., :2, :2].detach()
    )


def believed_table(t: torch.Tensor, solution: Believed, outage: Outage) -> pd.DataFrame:
    """Return a filter's solution through an outage as a table, with its standard deviations.

    Args:
        t: Times of the trajectory, s, shape (T,).
        solution: The filter's solution.
        outage: The outage.
    """
    table = solution_table(t, solution.trajectory, outage)
    return with_deviations(table, t[solution.end], solution.covariance)
