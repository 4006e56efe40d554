"""RMS errors of every state over whole drives: filters of a recipe side by side, GNSS throughout.

[Ghouneem2024] Tables II and III. Solutions are causal: what a filter said while the car drove.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import pandas as pd

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.baselines import FilterRuns, filter_options
from navlearn.experiment.drive import open_log, set_clocks
from navlearn.experiment.ins_filter_runs import VARIANTS, InsFilterRuns, ins_filter_options
from navlearn.experiment.methods import RISS
from navlearn.experiment.solution_tables import ins_solution_table, solution_table
from navlearn.experiment.sweep_drives import gyro_class, make_drive
from navlearn.experiment.tight_filter_runs import TIGHT, TightFilterRuns
from navlearn.experiment.tuned_elsewhere import tuned_until
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.schedule import Outage
from navlearn.outages.state_errors import VELOCITY_TIME, judged_together, state_errors
from navlearn.recipe import Recipe, load_recipe
from navlearn.recipe.sweep import SweepRecipe, is_sweep, load_sweep
from navlearn.recipe.swept_drives import SimulatedDrives
from navlearn.states import InsState

SETTLE: Final = 60.0
"""So long after alignment errors do not count, s."""

RECEIVER: Final = "receiver"
"""Name of the fixes themselves as a solution."""


def filters_of(recipe: Recipe) -> tuple[str, ...]:
    """Return the methods of a recipe that are filters: what runs over a whole drive.

    Args:
        recipe: The recipe.
    """
    return tuple(name for name in recipe.methods if name in (*RISS, *VARIANTS, *TIGHT))


def whole_solution(log: DriveLog, recipe: Recipe, method: str) -> pd.DataFrame:
    """Return what a filter says over a whole drive, while it is driven.

    Args:
        log: The drive, latencies removed.
        recipe: Tells the filters' options.
        method: A name of :func:`filters_of`.

    Returns:
        A solution table, from alignment on.
    """
    everything = Outage(float(log.imu["t"].iloc[0]) - 1.0, log.duration + 2.0)
    if method in VARIANTS:
        options = ins_filter_options(recipe, method, log)
        line, _, run = InsFilterRuns(recipe).run(log, options)
        return ins_solution_table(line.t[run.first :], run.history.trajectory, everything)
    if method in TIGHT:
        span, _, _, tight = TightFilterRuns(recipe).run(log, method)
        path, t = tight.history.trajectory, span.t[tight.first :]
        if isinstance(path, InsState):
            return ins_solution_table(t, path, everything)
    else:
        timeline, _, one = FilterRuns(recipe).run(log, filter_options(recipe, method, log))
        path, t = one.history.trajectory, timeline.t[one.first :]
    table = solution_table(t, path, everything)
    # the velocity of one gyro and an odometer is the mean over the interval that ends here
    return table.assign(**{VELOCITY_TIME: table["t"] - 0.5 * table["t"].diff().bfill()})


def drive_errors(
    log: DriveLog,
    recipe: Recipe,
    methods: Sequence[str] | None = None,
    *,
    settle: float = SETTLE,
) -> pd.DataFrame:
    """Return the errors of every state, of the receiver's fixes and of each filter.

    Args:
        log: The drive, with a reference, latencies removed.
        recipe: Tells the filters and their options.
        methods: Which of its filters; None means all.
        settle: So long after alignment errors do not count, s; nor do they before the end of what
            a filter was tuned on, for all filters alike.

    Returns:
        Rows of :func:`navlearn.outages.state_errors.judged_together`, with the drive's name. The
        filters are judged at the times that all of them have, the fixes where those are there.

    Raises:
        LogError: The log has no reference.
        ConfigError: No method is a filter, or all of the log served for tuning.
    """
    reference = log.reference
    if reference is None:
        raise LogError(
            f"{log.metadata.name}: errors over a whole drive need a reference; a log without one "
            "is judged by withheld fixes, through outages (navlearn run)"
        )
    names = filters_of(recipe) if methods is None else tuple(methods)
    if not names:
        raise ConfigError(f"recipe {recipe.name}: none of its methods is a filter; list some")
    until = tuned_until(recipe, log)
    if until is not None and until >= float(log.imu["t"].iloc[-1]):
        raise ConfigError(
            f"{log.metadata.name}: the filter was tuned on all of it; judge it on another drive"
        )
    errors = {name: state_errors(whole_solution(log, recipe, name), reference) for name in names}
    found = judged_together(errors, settle, until)
    fixes = state_errors(log.fixes, reference)
    fixes = fixes[fixes["t"].isin(found["t"])].assign(solution=RECEIVER)
    return pd.concat((fixes, found), ignore_index=True).assign(drive=log.metadata.name)


class WholeDrive(NamedTuple):
    """A drive of a recipe or of a sweep.

    Attributes:
        group: What it is counted with: the class of its gyro, or its own name.
        recipe: Its recipe.
        log: The log, latencies removed.
    """

    group: str
    recipe: Recipe
    log: DriveLog


def drives_of(
    path: Path, clocks_until: float, drives: int | None = None, first_seed: int | None = None
) -> Iterator[WholeDrive]:
    """Yield the drives of a recipe or a sweep.

    Args:
        path: The recipe's file.
        clocks_until: Latencies are estimated from what lies before this time, s.
        drives: At most so many of each grade; None means all.
        first_seed: Seed of the first simulated drive; None means the sweep's own.
    """
    if not is_sweep(path):
        recipe = load_recipe(path)
        log, _ = set_clocks(open_log(recipe), recipe, clocks_until)
        yield WholeDrive(log.metadata.name, recipe, log)
        return
    sweep = load_sweep(path).shortened(drives=drives)
    for grade in sweep.sweep.grades:
        for seed in _seeds(sweep, first_seed):
            made, _ = make_drive(sweep, grade, seed)
            recipe = sweep.for_drive(made.metadata.name, sweep.sweep.durations_s[0], grade)
            log, _ = set_clocks(made, recipe, clocks_until)
            yield WholeDrive(gyro_class(grade), recipe, log)


def _seeds(sweep: SweepRecipe, first_seed: int | None) -> tuple[int, ...]:
    if first_seed is None or not isinstance(sweep.sweep, SimulatedDrives):
        return sweep.sweep.seeds
    return tuple(range(first_seed, first_seed + sweep.sweep.drives))
