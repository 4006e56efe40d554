"""The methods of a full IMU that learn nothing: strapdown alone, the filter, and its smoother."""

from typing import ClassVar

import numpy as np

from navlearn.experiment.ins_filter_runs import (
    InsFilterRuns,
    imu_timeline_of,
    ins_filter_options,
    stated_start,
)
from navlearn.experiment.solution_tables import ins_solution_table, with_deviations
from navlearn.fusion.ins_dead_reckoning import (
    InsDeadReckoningOptions,
    ins_dead_reckoning_start,
)
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_timeline import ImuTimeline
from navlearn.mechanization.ins_alignment_result import InsAlignment, InsAlignmentOptions
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.states import ImuSample


class InsFilterMethod:
    """The full-IMU filter through the outage: it predicts with all that it has estimated."""

    def __init__(self, runs: InsFilterRuns, method: str) -> None:
        """Make a method of a variant of the filter.

        Args:
            runs: Filter runs, shared with the other methods.
            method: A name of :data:`navlearn.experiment.ins_filter_runs.VARIANTS`.
        """
        self.runs, self.method = runs, method

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the filter's prediction through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        options = ins_filter_options(self.runs.recipe, self.method, log)
        line, _, run = self.runs.run(log, options)
        t, history = line.t[run.first :], run.history
        table = ins_solution_table(t, history.trajectory, outage)
        return Solution(
            table=with_deviations(table, t[history.end], history.belief.covariance[..., :2, :2]),
            notes={"filter": history.method, "alignment": run.alignment.method},
        )


class InsDeadReckoning:
    """Strapdown alone from the last fix on, with the attitude and biases known there."""

    def __init__(self, recipe: Recipe) -> None:
        """Make the method.

        Args:
            recipe: The recipe.
        """
        self.recipe = recipe

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return dead reckoning through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        line, stated = imu_timeline_of(log, self.recipe), stated_start(log)
        if stated is not None and not bool(line.fixes.has_velocity.any()):
            return _free_from(stated, line, outage)
        arm = ins_filter_options(self.recipe, log=log).lever_arm
        start = ins_dead_reckoning_start(
            line.samples,
            line.fixes,
            line.timing,
            InsDeadReckoningOptions(alignment=InsAlignmentOptions(lever_arm=arm)),
            bridged=line.bridged,
        )
        after = slice(start.sample + 1, None)
        samples = ImuSample(*(channel[after] for channel in line.samples))
        path = strapdown_over_time(
            start.state, samples, gyro_bias=start.gyro_bias, accel_bias=start.accel_bias
        )
        bias = np.degrees(start.gyro_bias.numpy()) * 3600.0
        return Solution(
            table=ins_solution_table(line.t[after], path, outage),
            notes={f"gyro_bias_{axis}_deg_per_h": float(bias[i]) for i, axis in enumerate("xyz")},
        )


def _free_from(stated: InsAlignment, line: ImuTimeline, outage: Outage) -> Solution:
    """Return the strapdown's own path since a stated start: fixes without velocity tell none."""
    path = strapdown_over_time(stated.state, line.samples)
    return Solution(
        table=ins_solution_table(line.t, path, outage), notes={"since": "the log's stated start"}
    )


class InsSmoothed:
    """The full-IMU filter, smoothed from fixes on both sides of an outage.

    Attributes:
        sees_after: For how long after the outage's end the method sees fixes and sensors, s.
    """

    sees_after: ClassVar[float] = 120.0

    def __init__(self, runs: InsFilterRuns) -> None:
        """Make the method.

        Args:
            runs: Filter runs, shared with the other methods.
        """
        self.runs = runs

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the smoothed solution through an outage.

        Args:
            log: The drive up to ``sees_after`` after the outage's end, without fixes inside it.
            outage: The outage.
        """
        line, navigator, run = self.runs.run(log)
        t = line.t[run.first :]
        found = navigator.smooth(run, line.fixes, line.timing)
        table = ins_solution_table(t, found.trajectory, outage)
        return Solution(
            table=with_deviations(table, t[found.end], found.belief.covariance[..., :2, :2])
        )
