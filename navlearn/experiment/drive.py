"""A recipe's drive: read, checked for its outages, its clocks set right.

Latencies are estimated from what lies before the first scored outage only, once, for every
method alike.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError
from navlearn.logs.clock import without_latency
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality import Estimate, gnss_latency, odometer_latency
from navlearn.logs.reading import read_log
from navlearn.logs.resample import RissTimeline, riss_timeline
from navlearn.outages.placement import place_outages
from navlearn.outages.schedule import Placement
from navlearn.recipe import Recipe

CLEAR = 3.0
"""A latency is removed where it is this many of its own standard deviations from zero."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive ready for an experiment.

    Attributes:
        log: The log with its latencies removed.
        placement: Its outages.
        notes: What was done to its clocks, in words.
    """

    log: DriveLog
    placement: Placement
    notes: tuple[str, ...]


def open_log(recipe: Recipe) -> DriveLog:
    """Return the log that a recipe names.

    Args:
        recipe: The recipe.

    Raises:
        LogNotFoundError: It does not exist.
        LogError: It cannot be used as it is.
    """
    source = recipe.log
    path = source.descriptor if source.descriptor is not None else source.path
    if path is None:
        raise ConfigError(f"recipe {recipe.name}: log names neither a descriptor nor a path")
    return read_log(path, format=source.format)


def prepare_drive(recipe: Recipe, *, until: float | None = None) -> Drive:
    """Read a recipe's log, place its outages and set its clocks right.

    Args:
        recipe: The recipe.
        until: Latencies are estimated from what lies before this time, s; None stands for the
            start of the first outage.

    Returns:
        The drive.

    Raises:
        LogError: The log cannot be used, or the outages do not fit into it.
    """
    log = open_log(recipe)
    placement = place_outages(recipe.outages.protocol(), log)
    first = min((outage.start for outage in placement.outages), default=np.inf)
    log, notes = set_clocks(log, recipe, first if until is None else until)
    return Drive(log=log, placement=placement, notes=notes)


def set_clocks(log: DriveLog, recipe: Recipe, until: float) -> tuple[DriveLog, tuple[str, ...]]:
    """Return the log with its latencies removed, and what was removed.

    Args:
        log: The log; latencies that its reader knows stay as they are where the recipe says
            ``estimate``.
        recipe: Its ``calibration`` section tells numbers, or ``estimate``.
        until: Nothing at or after this time is used, s.
    """
    known = log.metadata
    if known.latency_removed:
        return log, ("clocks: latencies were removed by the log's descriptor",)
    wanted = recipe.calibration
    notes = []
    values: dict[str, float] = {}
    for name, asked, estimate in (
        ("gnss_latency", wanted.gnss_latency, gnss_latency),
        ("odometer_latency", wanted.odometer_latency, odometer_latency),
    ):
        stated = float(getattr(known, name))
        if asked != "estimate":
            values[name], how = float(asked), "as the recipe says"
        elif stated != 0.0:
            values[name], how = stated, "as the log's descriptor says"
        else:
            values[name], how = _clear(estimate(log, until=until), until)
        notes.append(f"clocks: {name} {values[name]:+.3f} s, {how}")
    metadata = replace(
        known, gnss_latency=values["gnss_latency"], odometer_latency=values["odometer_latency"]
    )
    return without_latency(replace(log, metadata=metadata)), tuple(notes)


def _clear(found: Estimate | None, until: float) -> tuple[float, str]:
    before = f"from the drive before {until:.0f} s"
    if found is None:
        return 0.0, f"not observable {before}"
    if abs(found.value) < CLEAR * found.std:
        return 0.0, f"{found.value:+.3f} ± {found.std:.3f} s {before} is not clear of zero"
    return found.value, f"± {found.std:.3f} s {before}"


def timeline_of(log: DriveLog, recipe: Recipe, end: float | None = None) -> RissTimeline:
    """Return a log as the tensors that filters take.

    Args:
        log: The log, latencies removed.
        recipe: Its ``mechanization`` section tells rate and dimensions.
        end: The odometer's last value is held until then where its samples end a moment
            earlier, s; None holds nothing.
    """
    if end is not None:
        log = replace(log, odometer=_held(log.odometer, end))
    return riss_timeline(log, rate_hz=recipe.mechanization.rate_hz, dims=recipe.mechanization.dims)


def _held(odometer: pd.DataFrame, end: float) -> pd.DataFrame:
    if odometer.empty or float(odometer["t"].iloc[-1]) >= end:
        return odometer
    last = odometer.iloc[[-1]].assign(t=end)
    return pd.concat([odometer, last], ignore_index=True)
