"""Methods that know what no method can know: they show how much there is to gain.

``oracle`` is the filter on a gyro whose deterministic errors are taken off, noise and drift
left; ``noise_free_gyro`` is the filter on an error-free gyro; ``perfect_azimuth`` takes the
reference's azimuth through the outage. The filters are told how noisy the gyro is that is left
to them, so that nothing beyond noise keeps a method from doing as well.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch

from navlearn.errors import ConfigError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.baselines import (
    FilterRuns,
    believed,
    believed_table,
    filter_options,
)
from navlearn.experiment.perfect_azimuth import KnownAzimuth, known_azimuth, reckoned
from navlearn.experiment.solution_tables import solution_table
from navlearn.fusion.options import EkfOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.navigator import belief_at
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.outages.track import track_of
from navlearn.recipe import Recipe
from navlearn.states import RissSample, Trajectory

GYRO_ORACLES: Final = ("oracle", "noise_free_gyro")
"""Oracles that need what only a simulation knows of its gyro."""

AZIMUTH_ORACLES: Final = ("perfect_azimuth",)
"""Oracles that need an azimuth in the reference."""

SPAN: Final = 60.0
"""Drift is measured over this time, s: what happens within an outage."""

LEAST_WALK: Final = 2e-5
"""Least angle random walk that a filter is told, rad/√s: slopes and crossfall are left in 2D."""

LEAST_DRIFT: Final = 2e-7
"""Least random walk of its bias, rad/s/√s."""

TURN_NOISE: Final = 0.006
"""What turning adds, √s: a gyro of known scale is not quite a yaw rate on slopes."""


@dataclass(frozen=True, kw_only=True)
class GyroNoise:
    """How noisy a gyro is.

    Attributes:
        random_walk: Angle random walk, rad/√s.
        drift: Random walk of the bias, rad/s/√s.
    """

    random_walk: float = LEAST_WALK
    drift: float = LEAST_DRIFT


def gyro_noise(log: DriveLog, truth: SensorTruth) -> GyroNoise:
    """Return how noisy the gyro of a log is once its deterministic error is taken off.

    Args:
        log: The log.
        truth: At its stamps.
    """
    dt = float(np.median(np.diff(truth.t)))
    known = truth.yaw_rate + truth.gyro_error + truth.gyro_drift
    white = float(np.std(log.imu["gyro_z"].to_numpy(np.float64) - known))
    lag = min(max(1, round(SPAN / dt)), truth.t.size - 1)
    change = truth.gyro_drift[lag:] - truth.gyro_drift[:-lag]
    return GyroNoise(
        random_walk=float(np.hypot(white * np.sqrt(dt), LEAST_WALK)),
        drift=float(np.hypot(np.sqrt(np.mean(change**2) / (lag * dt)), LEAST_DRIFT)),
    )


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What oracles may know of a drive; no other method is handed it.

    Attributes:
        gyro: Parts of the yaw gyro's readings; None where no simulation knows them.
        noise: Of that gyro once its deterministic error is taken off.
        azimuth: Azimuth by the reference; None where it tells none.
    """

    gyro: SensorTruth | None = None
    noise: GyroNoise = GyroNoise()
    azimuth: KnownAzimuth | None = None


def truth_for(recipe: Recipe, log: DriveLog, gyro: SensorTruth | None) -> Truth | None:
    """Return what the oracles among a recipe's methods need.

    Args:
        recipe: The recipe.
        log: The whole drive.
        gyro: What a simulation knows of its gyro, if there was one.

    Returns:
        The truth, or None where the recipe has no oracle.

    Raises:
        ConfigError: An oracle is asked for what nobody knows.
    """
    of_gyro = [name for name in recipe.methods if name in GYRO_ORACLES]
    of_azimuth = [name for name in recipe.methods if name in AZIMUTH_ORACLES]
    if of_gyro and gyro is None:
        raise ConfigError(
            f"recipe {recipe.name}: {', '.join(of_gyro)} needs a simulated drive: "
            f"{log.metadata.name} has no sensor truth beside it; leave the method out, or make a "
            "drive with navlearn simulate"
        )
    if not of_gyro and not of_azimuth:
        return None
    azimuth = known_azimuth(track_of(log)) if of_azimuth else None
    if of_azimuth and azimuth is None:
        raise ConfigError(
            f"recipe {recipe.name}: {', '.join(of_azimuth)} needs a reference with azimuth or "
            f"velocity, which {log.metadata.name} does not have; leave the method out"
        )
    if not of_gyro or gyro is None:
        return Truth(azimuth=azimuth)
    here = gyro.of(log)
    return Truth(gyro=here, noise=gyro_noise(log, here), azimuth=azimuth)


def told(base: EkfOptions, noise: GyroNoise) -> EkfOptions:
    """Return a filter that is told how noisy its gyro is, and that it has no other error.

    Args:
        base: The honest filter.
        noise: Of the gyro.
    """
    own = base.noise
    quiet = replace(
        own,
        gyro_random_walk=_floored(noise.random_walk, LEAST_WALK, own.gyro_random_walk),
        gyro_bias_walk=_floored(noise.drift, LEAST_DRIFT, own.gyro_bias_walk),
        turn_noise=min(TURN_NOISE, own.turn_noise),
    )
    return replace(base, noise=quiet)


def _floored(measured: float, floor: float, honest: float) -> float:
    """Return a noise that the floor does not lift above what the honest filter assumes."""
    return measured if measured > floor else min(floor, honest)


class GyroOracle:
    """The filter on a gyro whose deterministic error, or all of its error, is taken off."""

    def __init__(self, runs: FilterRuns, truth: Truth | None, *, noise_free: bool) -> None:
        """Make the oracle.

        Args:
            runs: Filter runs, shared with the other methods.
            truth: With what a simulation knows of its gyro.
            noise_free: Whether noise and drift are taken off, too.

        Raises:
            ConfigError: Nothing is known of the gyro.
        """
        if truth is None or truth.gyro is None:
            raise ConfigError("oracle: needs a simulated drive, and the truth of its gyro")
        self.runs, self.truth, self.gyro, self.noise_free = runs, truth, truth.gyro, noise_free

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the filter's prediction through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        gyro = self.gyro.of(log)
        rate, noise = gyro.yaw_rate, GyroNoise()
        if not self.noise_free:
            rate = log.imu["gyro_z"].to_numpy(np.float64) - gyro.gyro_error
            noise = self.truth.noise
        better = log.with_tables({"imu": log.imu.assign(gyro_z=rate)})
        options = told(filter_options(self.runs.recipe, log=better), noise)
        timeline, _, run = self.runs.run(better, options)
        table = believed_table(timeline.t[run.first :], believed(run.history), outage)
        return Solution(table=table)


class PerfectAzimuth:
    """The filter up to its last fix; then its odometer along the reference's azimuth."""

    def __init__(self, runs: FilterRuns, truth: Truth | None) -> None:
        """Make the oracle.

        Args:
            runs: Filter runs, shared with the other methods.
            truth: With an azimuth.

        Raises:
            ConfigError: No azimuth is known.
        """
        if truth is None or truth.azimuth is None:
            raise ConfigError("perfect_azimuth: needs a reference with azimuth or velocity")
        self.runs, self.azimuth = runs, truth.azimuth

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return dead reckoning along the reference's azimuth through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        timeline, navigator, run = self.runs.run(log)
        t = timeline.t[run.first :]
        block, gone = last_fix(run)
        through = RissSample(*(channel[gone:] for channel in run.samples))
        middle = (t[gone:] - 0.5 * through.dt).numpy()
        later = reckoned(
            navigator.options.filter,
            belief_at(run.history, block),
            through,
            torch.from_numpy(self.azimuth.at(middle)),
        )
        before = run.history.trajectory
        joined = Trajectory(
            *(torch.cat((old[:gone], new)) for old, new in zip(before, later, strict=True))
        )
        return Solution(table=solution_table(t, joined, outage))
