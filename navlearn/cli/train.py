"""``navlearn train``: fit error models on a whole drive, without outages."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import (
    ForceOption,
    FormatOption,
    QuietOption,
    RunFolderOption,
    split_words,
)


def train(
    source: Annotated[Path, typer.Argument(help="Recipe (.yaml), or a log file or folder.")],
    out: RunFolderOption,
    format: FormatOption = None,
    methods: Annotated[
        str, typer.Option("--methods", help="Models to fit on a log, separated by commas.")
    ] = "anarx",
    model: Annotated[
        list[Path] | None,
        typer.Option("--model", help="Model spec (.yaml) of a method; may be given repeatedly."),
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Fit the error models of a recipe, or of a log, and save them."""
    from navlearn.experiment import train_recipe
    from navlearn.recipe import load_recipe, recipe_for

    if format is None and _is_recipe(source):
        recipe = load_recipe(source)
    else:
        recipe = recipe_for(source, format, methods=split_words(methods), models=model or ())
    result = train_recipe(recipe, out, force=force, progress=not quiet)
    typer.echo(f"Models: {result.folder / 'models'}")


def _is_recipe(source: Path) -> bool:
    """Return whether a YAML file is a recipe, which names a log, and not a descriptor."""
    from navlearn.recipe.yaml_file import read_yaml

    if source.suffix.lower() not in {".yaml", ".yml"}:
        return False
    return "path" not in read_yaml(source, what="recipe or descriptor").content
