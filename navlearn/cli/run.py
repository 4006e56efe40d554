"""``navlearn run``: a recipe from log to report."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import ForceOption, QuietOption, RunFolderOption


def run(
    recipe: Annotated[Path, typer.Argument(help="Recipe, such as training/first_look.yaml.")],
    out: RunFolderOption,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run a recipe: table of outages, summary, report with plots, and fitted models."""
    from navlearn.recipe import load_recipe

    loaded = load_recipe(recipe)
    from navlearn.cli.result import run_and_show

    run_and_show(loaded, out, force=force, progress=not quiet)
