"""Running a recipe from a command, and what is shown of the result."""

from pathlib import Path

import typer

from navlearn.recipe import Recipe


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
    table = by_method.agg(["count", "mean", "median"]).rename(columns={"count": "outages"})
    typer.echo("Maximum horizontal error per outage, m:")
    typer.echo(table.reset_index().to_string(index=False, float_format="{:.2f}".format))
    typer.echo(f"Report: {result.folder / 'report.md'}")
