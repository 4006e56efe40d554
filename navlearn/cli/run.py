"""``navlearn run``: a recipe from log to report, or a sweep over many drives."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import ForceOption, QuietOption, RunFolderOption
from navlearn.errors import ConfigError


def run(
    recipe: Annotated[Path, typer.Argument(help="Recipe, such as training/first_look.yaml.")],
    out: RunFolderOption,
    processes: Annotated[
        int | None,
        typer.Option("--processes", min=1, help="Sweeps: drives at once; all cores if left out."),
    ] = None,
    drives: Annotated[
        int | None, typer.Option("--drives", min=1, help="Sweeps: drives per class, to look in.")
    ] = None,
    outages: Annotated[
        int | None,
        typer.Option("--outages", min=1, help="Sweeps: outages per drive and length, likewise."),
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run a recipe: table of outages, summary, report with plots, and fitted models.

    A sweep goes on where it stopped. It exits with 1 where drives could not be run; the report
    tells which, and the same command tries them again.
    """
    from navlearn.recipe import load_recipe
    from navlearn.recipe.sweep import is_sweep, load_sweep

    if is_sweep(recipe):
        from navlearn.cli.result import sweep_and_show

        sweep = load_sweep(recipe).shortened(drives=drives, outages=outages)
        sweep_and_show(sweep, out, processes=processes, force=force, progress=not quiet)
        return
    asked = {"--processes": processes, "--drives": drives, "--outages": outages}
    given = [name for name, value in asked.items() if value is not None]
    if given:
        raise ConfigError(f"{', '.join(given)}: for sweeps only; {recipe} runs on one drive")
    loaded = load_recipe(recipe)
    from navlearn.cli.result import run_and_show

    run_and_show(loaded, out, force=force, progress=not quiet)
