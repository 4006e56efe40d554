"""How good positions are over a whole drive: what the receiver says, ranges alone, and filters.

No outage is made. Every solution is judged at the reference's own times, canyons apart; what a
canyon is depends on what is received, never on errors.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError
from navlearn.experiment.range_fixes import with_fixes
from navlearn.experiment.state_rmse import whole_solution
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.state_errors import state_errors
from navlearn.outages.track import track_of
from navlearn.recipe import Recipe, load_recipe
from navlearn.recipe.log_section import LogSource
from navlearn.recipe.sweep import is_sweep, load_sweep
from navlearn.recipe.swept_drives import RecordedDrives

OPEN_SKY: Final = 6
"""Satellites received outside a canyon, at least."""

SPAN: Final = 5.0
"""Seconds before and after a moment over which received satellites are averaged."""

POSITION: Final = {"longitude": "east", "latitude": "north", "altitude": "up"}
"""Errors of position, and what they are called here."""


def whole_drive(log: DriveLog, recipe: Recipe) -> pd.DataFrame:
    """Return the errors of every solution over a drive.

    Args:
        log: The drive, with ranges and reference; its fixes, where it has any, are judged too.
        recipe: Tells the filters' options.

    Returns:
        One row per solution and time of the reference: ``solution``, ``t`` (s), ``east``,
        ``north``, ``up``, ``horizontal`` (errors, m), ``canyon`` (whether).
    """
    track = track_of(log)
    judge = pd.DataFrame({name: getattr(track, name) for name in ("t", "lat", "lon", "height")})
    rows = [
        state_errors(table, judge)[["t", *POSITION]].rename(columns=POSITION).assign(solution=name)
        for name, table in _solutions(log, recipe)
    ]
    errors = pd.concat(rows, ignore_index=True)
    return errors.assign(
        horizontal=np.hypot(errors["east"], errors["north"]),
        canyon=in_canyon(log, errors["t"].to_numpy()),
    )


def recorded_drives(path: Path, log: Path | None = None) -> list[Recipe]:
    """Return one recipe per drive of a recipe, or of a sweep over recorded drives.

    Args:
        path: The recipe's file.
        log: Descriptor of another log; None takes the recipe's own.

    Raises:
        ConfigError: The drives of a sweep are simulated.
    """
    if not is_sweep(path):
        one, logs = load_recipe(path), []
    else:
        sweep = load_sweep(path)
        if not isinstance(sweep.sweep, RecordedDrives):
            raise ConfigError(f"{path}: its drives are simulated; give a recipe of recorded drives")
        one = sweep.for_drive(sweep.name, sweep.sweep.durations_s[0], sweep.sweep.grades[0])
        logs = [sweep.sweep.source(number) for number in sweep.sweep.seeds]
    if log is not None:
        logs = [LogSource(descriptor=log)]
    return [one.model_copy(update={"log": source}) for source in logs] or [one]


def summary(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the figures of a drive, by where it was and by solution.

    Args:
        errors: As :func:`whole_drive` returns them.

    Returns:
        Times judged, median, 95th percentile, RMS and largest horizontal error, and the 95th
        percentile of the vertical error, m.
    """
    common = errors.groupby("t")["solution"].transform("nunique") == errors["solution"].nunique()
    parts: Mapping[str, pd.DataFrame] = {
        "all": errors,
        f"{OPEN_SKY} satellites and more": errors[~errors["canyon"]],
        "fewer: canyon": errors[errors["canyon"]],
        "where all have one": errors[common],
    }
    told = []
    for where, part in parts.items():
        for solution, rows in part.groupby("solution", sort=False):
            off = rows["horizontal"]
            told.append(
                {
                    "where": where,
                    "solution": solution,
                    "times": len(off),
                    "median": off.median(),
                    "95 %": off.quantile(0.95),
                    "RMS": float(np.sqrt((off**2).mean())),
                    "largest": off.max(),
                    "95 % up": rows["up"].abs().quantile(0.95),
                }
            )
    return pd.DataFrame(told)


def in_canyon(log: DriveLog, t: np.ndarray) -> np.ndarray:
    """Return where a drive was in a canyon: fewer than six satellites were received on average.

    Args:
        log: The drive.
        t: Times, s, shape (N,).

    Returns:
        Whether, bool, shape (N,).
    """
    if log.ranges is None:
        return np.zeros(t.shape, dtype=bool)
    count = log.ranges.groupby("t").size()
    at, seen = count.index.to_numpy(np.float64), count.to_numpy(np.float64)
    total = np.concatenate(([0.0], np.cumsum(seen)))
    period = float(np.median(np.diff(at))) if at.size > 1 else 1.0
    first, last = np.searchsorted(at, t - SPAN), np.searchsorted(at, t + SPAN, side="right")
    # a reception that is missing altogether counts as one of no satellite
    expected = np.maximum(last - first, np.round(2.0 * SPAN / period))
    return np.asarray((total[last] - total[first]) / np.maximum(expected, 1.0) < OPEN_SKY)


def _solutions(log: DriveLog, recipe: Recipe) -> Iterator[tuple[str, pd.DataFrame]]:
    alone = with_fixes(replace(log, fixes=log.fixes.iloc[:0]), recipe)
    loose = "ins_ekf" if recipe.mechanization.sensors == "imu" else "ekf"
    yield "single point", alone.fixes
    if len(log.fixes):
        yield "receiver's fixes", log.fixes
        yield "loose, receiver's fixes", whole_solution(log, recipe, loose)
    yield "loose, single point", whole_solution(alone, recipe, loose)
    yield "tight", whole_solution(log if len(log.fixes) else alone, recipe, "tc_ekf")
