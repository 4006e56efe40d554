"""Running a recipe from a command, and what is shown of the result."""

import textwrap
from pathlib import Path

import typer

from navlearn.recipe import Recipe

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
    for line in result.summary["meaning"]:
        whole = f"- {line}".replace(" %", HELD_SPACE + "%").replace(" m)", HELD_SPACE + "m)")
        typer.echo(
            textwrap.fill(whole, LINE_WIDTH, subsequent_indent="  ").replace(HELD_SPACE, " ")
        )
    typer.echo(f"\nReport: {result.folder / 'report.md'}")
