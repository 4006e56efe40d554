"""A filter's run with more of the gyro's errors estimated than its bias.

Terms of turning and force are states. The effect of temperature, where the log tells it, is a
constant times how much warmer than at the start the sensor is: a second run, over a gyro with
some of it taken off, tells the constant.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.experiment.baselines import Believed, FilterRuns, believed, filter_options
from navlearn.filters.belief import Belief
from navlearn.fusion.separate_parameter import SeparateParameter, separate_parameter
from navlearn.logs.drive_log import DriveLog
from navlearn.navigator import Navigator, NavigatorRun, belief_at
from navlearn.recipe.augmented_spec import AugmentedSpec
from navlearn.states import RissSample, Trajectory

AMOUNT = 1e-4
"""How much of a temperature coefficient the second run takes off, rad/s per K."""


class Thermal(NamedTuple):
    """What temperature does to the gyro.

    Attributes:
        warmth: How much warmer than at the start the sensor is, K, shape (T,).
        known: The coefficient as it was known after each block, rad/s per K, and the beliefs
            with it.
    """

    warmth: Tensor
    known: SeparateParameter


@dataclass(frozen=True, kw_only=True)
class AugmentedRun:
    """A drive as the filter with more gyro terms saw it.

    Attributes:
        navigator: What ran.
        run: Its run.
        thermal: The effect of temperature; None where it is not estimated.
    """

    navigator: Navigator
    run: NavigatorRun
    thermal: Thermal | None

    def belief(self, block: Tensor | int) -> Belief:
        """Return what was believed after some blocks.

        Args:
            block: Index or indices of blocks, int64, shape (...).
        """
        if self.thermal is None:
            return belief_at(self.run.history, block)
        known = self.run.history._replace(belief=self.thermal.known.belief)
        return belief_at(known, block)

    def coast(self, block: Tensor, rows: Tensor) -> Trajectory:
        """Mechanize from what was believed after blocks, without fixes.

        Args:
            block: Indices of blocks, int64, shape (N,).
            rows: Samples that follow each, int64, shape (N, L).
        """
        window = RissSample(*(channel[rows] for channel in self.run.samples))
        return self.navigator.coast(self.belief(block), window, self._rate_error(block, rows))

    def solution(self, block: int) -> Believed:
        """Return the filter's solution over the drive.

        Args:
            block: The one that ends with the last fix.
        """
        before = believed(self.run.history)
        gone = int(self.run.history.end[block]) + 1
        rows = torch.arange(gone, len(self.run.samples.dt))
        error = self._rate_error(torch.tensor(block), rows)
        if error is None or len(rows) == 0:
            return before
        samples = RissSample(*(channel[rows] for channel in self.run.samples))
        after = believed(self.navigator.filter_on(self.belief(block), samples, error))
        paths = zip(before.trajectory, after.trajectory, strict=True)
        return Believed(
            Trajectory(*(torch.cat((old[:gone], new)) for old, new in paths)),
            torch.cat((before.end[: block + 1], after.end + gone)),
            torch.cat((before.covariance[: block + 1], after.covariance)),
        )

    def _rate_error(self, block: Tensor, rows: Tensor) -> Tensor | None:
        if self.thermal is None:
            return None
        return self.thermal.known.value[block].unsqueeze(-1) * self.thermal.warmth[rows]


def augmented_run(runs: FilterRuns, log: DriveLog, spec: AugmentedSpec) -> AugmentedRun:
    """Run the filter with more gyro terms over a log.

    Args:
        runs: Filter runs, shared with the other methods.
        log: The drive up to an outage's end, without fixes from its start.
        spec: Its terms.

    Raises:
        FilterDivergedError: The filter lost its way.
    """
    options = spec.filter_options(filter_options(runs.recipe, log=log))
    timeline, navigator, run = runs.run(log, options)
    cooler = cooled(log) if spec.thermal else None
    if cooler is None:
        return AugmentedRun(navigator=navigator, run=run, thermal=None)
    other, _, less = runs.run(cooler, options, series="cooler")
    warmth = (timeline.samples.yaw_rate - other.samples.yaw_rate) / AMOUNT
    known = separate_parameter(
        navigator.filter.model, run.history, less.history, AMOUNT, spec.temperature_prior
    )
    return AugmentedRun(navigator=navigator, run=run, thermal=Thermal(warmth[run.first :], known))


def cooled(log: DriveLog) -> DriveLog | None:
    """Return the log with :data:`AMOUNT` per kelvin of warming taken off its gyro.

    Args:
        log: The drive.

    Returns:
        The log, or None where it tells no temperature, or one that never changes.
    """
    if "temperature" not in log.imu:
        return None
    temperature = log.imu["temperature"].ffill().bfill()
    if temperature.isna().any() or temperature.max() == temperature.min():
        return None
    warmth = temperature - temperature.iloc[0]
    gyro = log.imu["gyro_z"] - AMOUNT * warmth
    return log.with_tables({"imu": log.imu.assign(gyro_z=gyro)})
