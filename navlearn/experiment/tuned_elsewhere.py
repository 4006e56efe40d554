"""What a filter was tuned on proves nothing of it: such drives are not judged.

A part of a drive, or the same with faults in it, is that drive.
"""

import math
from collections.abc import Sequence

from navlearn.errors import ConfigError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.origin import drive_name
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.ingredients import ingredients_of


def tuned_until(recipe: Recipe, log: DriveLog) -> float | None:
    """Return up to which time the filter of a recipe's methods was tuned on a log.

    Args:
        recipe: The recipe.
        log: The log.

    Returns:
        The time, s, infinite for all of the log; None where it was not tuned on it, or where no
        method takes what was tuned.
    """
    spec = recipe.tuned
    if spec is None or not any(ingredients_of(name).tuned for name in recipe.methods):
        return None
    ends = [
        float("inf") if one.until_s is None else one.until_s
        for one in spec.made_from
        if one.log in (log.metadata.name, drive_name(log.metadata))
    ]
    return max(ends, default=None)


def check_tuned(recipe: Recipe, log: DriveLog, outages: Sequence[Outage]) -> None:
    """Refuse outages in what the filter was tuned on.

    Args:
        recipe: The recipe.
        log: Its drive.
        outages: Its outages.

    Raises:
        ConfigError: An outage begins before the end of what was tuned on.
    """
    until = tuned_until(recipe, log)
    first = min((outage.start for outage in outages), default=None)
    if until is None or first is None or first >= until:
        return
    where = f"up to {until:g} s" if math.isfinite(until) else "on all of it"
    raise ConfigError(
        f"recipe {recipe.name}: its first outage begins at {first:g} s of {log.metadata.name}, "
        f"whose drive its filter was tuned on, {where}; place "
        "outages later (outages.warm_up_s), or tune on other drives (navlearn tune --log)"
    )
