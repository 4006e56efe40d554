"""Fixes for a drive that has raw ranges alone, under the sky that a recipe tells of."""

from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.single_point_fixes import SinglePointFixOptions, with_single_point_fixes
from navlearn.recipe.experiment_base import Experiment


def with_fixes(log: DriveLog, recipe: Experiment) -> DriveLog:
    """Return a log that has fixes: its own, or single-point ones, each from its ranges alone.

    Args:
        log: The log.
        recipe: Its ``tight.range_noise`` tells how noisy ranges are: loose and tight coupling
            believe the same of them.

    Raises:
        LogError: It has neither fixes nor ranges that tell a position.
    """
    if len(log.fixes) or log.ranges is None:
        return log
    noise = recipe.tight_ekf_options().range_noise
    options = SinglePointFixOptions(single_point=SinglePointOptions(noise=noise))
    return with_single_point_fixes(log, options)
