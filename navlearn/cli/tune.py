"""``navlearn tune``: noise of a filter from drives, as a spec that recipes name."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navlearn.cli.arguments import ForceOption, QuietOption, split_words
from navlearn.errors import ConfigError

if TYPE_CHECKING:
    from navlearn.experiment.tuning_drives import Stretch
    from navlearn.recipe import Recipe


def tune(
    recipe: Annotated[Path, typer.Argument(help="Recipe, or a sweep over simulated drives.")],
    out: Annotated[Path, typer.Option("--out", help="The spec's file, such as tuned.yaml.")],
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="gradient: innovation likelihood, no reference; differences, ghouneem2024: from "
            "a reference; allan: from a standstill.",
        ),
    ] = "gradient",
    seeds: Annotated[
        str,
        typer.Option(
            "--seeds",
            help="Simulated recipes: tune on these draws, such as 11,12,13, in place of the "
            "recipe's own drive.",
        ),
    ] = "",
    log: Annotated[
        list[Path] | None,
        typer.Option(
            "--log",
            help="Tune on this log or descriptor, whole, in place of the recipe's own drive; may "
            "be given repeatedly.",
        ),
    ] = None,
    grade: Annotated[
        str | None, typer.Option("--grade", help="Sweeps: the grade of sensors to tune for.")
    ] = None,
    holdout: Annotated[
        float,
        typer.Option(
            "--holdout",
            help="Share held out to judge: of one drive its end, of several the last ones.",
        ),
    ] = 0.3,
    free: Annotated[
        str, typer.Option("--free", help="Noise entries to tune, separated by commas.")
    ] = "",
    spacing: Annotated[
        float,
        typer.Option(
            "--spacing",
            help="Only fixes at least so many seconds apart are foretold, in tuning and in "
            "judging its likelihood; entries of R then stay unless --free names them. 0: all.",
        ),
    ] = 0.0,
    iterations: Annotated[
        int, typer.Option("--iterations", min=1, help="Steps of the search at the most.")
    ] = 80,
    minutes: Annotated[
        float | None, typer.Option("--minutes", help="Time after which no step is begun.")
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Tune the noise of a recipe's filter, and judge it on held-out data.

    It is recommended where the held-out likelihood clearly gains and held-out outages are not
    worse.

    Of the recipe's own drive only what lies before its first outage is used. An interrupted
    search goes on where it stopped when the same command is given again.
    """
    from navlearn.cli.tuned import show_tuned
    from navlearn.experiment.tuning import refuse_overwriting, tune_recipe
    from navlearn.experiment.tuning_ways import METHODS
    from navlearn.learning.noise_options import TuningOptions

    if method not in METHODS:
        raise ConfigError(f"--method {method}: choose among {', '.join(METHODS)}")
    if not 0.0 <= holdout < 1.0:
        raise ConfigError(f"--holdout {holdout:g}: give a share from 0 to below 1")
    if not 0.0 <= spacing < math.inf:
        raise ConfigError(f"--spacing {spacing:g}: give seconds, 0 for all fixes")
    if method != "gradient" and (free or minutes is not None):
        raise ConfigError(f"--free, --minutes: for --method gradient only, not {method}")
    refuse_overwriting(out, force)
    loaded, stretches = _stretches(recipe, seeds, tuple(log or ()), grade, holdout)
    tuning = TuningOptions(
        free=tuple(split_words(free)) or None,
        spacing=spacing,
        iterations=iterations,
        minutes=math.inf if minutes is None else minutes,
    )
    result = tune_recipe(
        loaded,
        stretches,
        out,
        method=method,
        tuning=tuning,
        force=force,
        progress=not quiet,
    )
    show_tuned(result, out)


def _stretches(
    path: Path, seeds: str, logs: tuple[Path, ...], grade: str | None, holdout: float
) -> "tuple[Recipe, list[Stretch]]":
    """Return the recipe to tune for, and what it is tuned on."""
    from navlearn.experiment.tuning_drives import own_stretch, whole_stretches
    from navlearn.experiment.tuning_recipes import (
        other_draws,
        other_logs,
        recipe_of_grade,
        refuse_full_imu,
    )
    from navlearn.recipe import load_recipe
    from navlearn.recipe.sweep import is_sweep, load_sweep

    if seeds and logs:
        raise ConfigError("--seeds, --log: give one of them")
    if is_sweep(path):
        sweep = load_sweep(path, untuned=True)
        recipe, scored = recipe_of_grade(sweep, grade), tuple(sweep.sweep.seeds)
        if not seeds and not logs:
            raise ConfigError(
                f"{path}: every drive of a sweep is scored; give other draws with --seeds"
            )
    else:
        if grade is not None:
            raise ConfigError(f"--grade: for sweeps only; {path} runs on one drive")
        recipe = load_recipe(path, untuned=True)
        simulated = recipe.log.simulated
        scored = () if simulated is None else (simulated.seed,)
    refuse_full_imu(recipe)
    if seeds:
        draws = other_draws(recipe, _whole_numbers(seeds), scored)
        return recipe, whole_stretches(draws, holdout)
    if logs:
        return recipe, whole_stretches(other_logs(recipe, logs), holdout)
    return recipe, [own_stretch(recipe, holdout)]


def _whole_numbers(text: str) -> list[int]:
    try:
        return [int(word) for word in split_words(text)]
    except ValueError:
        raise ConfigError(
            f"--seeds {text!r} is not understood; write whole numbers separated by commas, such "
            "as 11,12"
        ) from None
