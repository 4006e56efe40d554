"""Running a recipe from a command, and what is shown of the result."""

import os
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from navlearn.recipe import Recipe

if TYPE_CHECKING:
    from navlearn.recipe.sweep import SweepRecipe

LINE_WIDTH = 100
HELD_SPACE = "\N{NO-BREAK SPACE}"
"""Keeps a figure and its unit on one line."""


def run_and_show(recipe: Recipe, out: Path, *, force: bool, progress: bool) -> None:
    """Run a recipe and print its headline figures and where the rest is.

    Args:
        recipe: What to run.
        out: Folder for the run.
        force: Whether an earlier run there may be overwritten.
        progress: Whether to show a progress bar.
    """
    from navlearn.experiment import run_recipe

    result = run_recipe(recipe, out, force=force, progress=progress)
    by_method = result.table.groupby("method", sort=False)["max_horizontal_error_m"]
    table = by_method.agg(["count", "mean", "median", "max"]).rename(columns={"count": "outages"})
    typer.echo("Maximum horizontal error per outage, m, over outages:")
    typer.echo(table.reset_index().to_string(index=False, float_format="{:.2f}".format) + "\n")
    _show_meaning(result.summary["meaning"])
    typer.echo(f"\nReport: {result.folder / 'report.md'}")


def sweep_and_show(
    recipe: "SweepRecipe", out: Path, *, processes: int | None, force: bool, progress: bool
) -> None:
    """Run a sweep and print its mean errors, what they mean, and where the rest is.

    Args:
        recipe: What to run.
        out: Folder for the run.
        processes: How many drives to run at once; None takes all cores.
        force: Whether an earlier run there may be overwritten.
        progress: Whether to show a progress bar.

    Raises:
        Exit: With 1 where some drives could not be run.
    """
    from navlearn.experiment.sweep import run_sweep
    from navlearn.outages.cells import cell_of, conditions
    from navlearn.outages.naming import words_and_unit

    at_once = processes or os.cpu_count() or 1
    result = run_sweep(recipe, out, processes=at_once, force=force, progress=progress)
    told = conditions(result.table)
    rows = result.table.to_dict(orient="records")
    cells = [f"{cell.gyro_class} {told[cell]}" for cell in map(cell_of, rows)]
    errors = result.table.assign(cell=cells).groupby(["method", "cell"], sort=False)
    table = errors[recipe.metric].mean().unstack("cell")
    table = table.reindex(index=list(recipe.methods), columns=list(dict.fromkeys(cells)))
    what, unit = words_and_unit(recipe.metric)
    typer.echo(f"Mean of the {what} per outage{unit and f', {unit}'}, by class and length:")
    typer.echo(table.to_string(float_format="{:.2f}".format) + "\n")
    _show_meaning(result.meaning)
    typer.echo(f"\nReport: {result.folder / 'report.md'}")
    for failure in result.failures:
        typer.echo(f"navlearn: not run: {failure.where}: {failure.reason}", err=True)
    if result.failures:
        raise typer.Exit(1)


def _show_meaning(lines: Iterable[str]) -> None:
    for line in lines:
        whole = f"- {line}".replace(" %", HELD_SPACE + "%").replace(" m)", HELD_SPACE + "m)")
        typer.echo(
            textwrap.fill(whole, LINE_WIDTH, subsequent_indent="  ").replace(HELD_SPACE, " ")
        )
