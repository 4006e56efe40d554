"""Whether a drive has the sensors that a recipe's methods need, told before anything is run."""

from typing import Final

import numpy as np

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.ins_filter_runs import VARIANTS, imu_timeline_of
from navlearn.experiment.tight_filter_runs import TIGHT
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.interval_means import typical_period
from navlearn.logs.six_axes import check_six_axes
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.recipe.range_error_spec import RangeErrorSpec

OF_EITHER: Final = ("dead_reckoning", "rts")
"""Methods that ``mechanization.sensors`` makes those of one gyro or of a full IMU."""

FASTER: Final = 1.05
"""A rate above that of the IMU by no more than this is one that jitters."""


def of_a_full_imu(recipe: Recipe) -> tuple[str, ...]:
    """Return what of a recipe needs six axes: methods by name, and the chapter on observability.

    Args:
        recipe: The recipe.
    """
    learned = {spec.name for spec in recipe.models if isinstance(spec, InsAnarxSpec)}
    full = recipe.mechanization.sensors == "imu"
    needed = {*VARIANTS, *learned, *(OF_EITHER if full else ())}
    chapter = ("observability",) if full and recipe.observability else ()
    return (*(name for name in recipe.methods if name in needed), *chapter)


def check_sensors(recipe: Recipe, log: DriveLog, outages: tuple[Outage, ...] = ()) -> None:
    """Refuse a drive that lacks the ranges or the full IMU which a recipe asks for.

    Args:
        recipe: The recipe.
        log: Its drive.
        outages: Its outages; up to the last one's end the IMU may have no hole.

    Raises:
        LogError: There are no ranges, or no six axes in SI units with gravity along z, or they
            have a hole.
        ConfigError: The strapdown is to step faster than the IMU.
    """
    _check_ranges(recipe, log)
    needed = of_a_full_imu(recipe)
    if not needed:
        return
    try:
        check_six_axes(log)
        _check_rate(recipe, log)
        if outages:
            imu_timeline_of(known_log(log, outages[-1]), recipe)
    except LogError as problem:
        raise LogError(f"{log.metadata.name}: {', '.join(needed)} cannot run: {problem}") from None


def tightly_coupled(recipe: Recipe) -> tuple[str, ...]:
    """Return what of a recipe needs raw ranges: methods by name.

    Args:
        recipe: The recipe.
    """
    learned = {spec.name for spec in recipe.models if isinstance(spec, RangeErrorSpec)}
    return tuple(name for name in recipe.methods if name in TIGHT or name in learned)


def _check_ranges(recipe: Recipe, log: DriveLog) -> None:
    needed = tightly_coupled(recipe)
    if needed and log.ranges is None:
        raise LogError(
            f"{log.metadata.name}: {', '.join(needed)} cannot run: the log has no raw ranges; use "
            "one that has (docs/logs.md), simulate them, or take loosely coupled methods"
        )


def _check_rate(recipe: Recipe, log: DriveLog) -> None:
    asked = recipe.mechanization.imu_rate_hz
    own = 1.0 / typical_period(log.imu["t"].to_numpy(np.float64))
    if asked is not None and asked > FASTER * own:
        raise ConfigError(
            f"mechanization.imu_rate_hz: found {asked:g}, but the IMU of {log.metadata.name} has "
            f"{own:.4g} samples per s; give that or less, or null for its own rate"
        )
