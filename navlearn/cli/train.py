"""``navlearn train``: fit error models on a whole drive, without outages."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import (
    DimsOption,
    ForceOption,
    FormatOption,
    ModelOption,
    QuietOption,
    RateOption,
    RunFolderOption,
    SeedOption,
    split_words,
)


def train(
    source: Annotated[Path, typer.Argument(help="Recipe (.yaml), or a log as for check.")],
    out: RunFolderOption,
    format: FormatOption = None,
    methods: Annotated[
        str, typer.Option("--methods", help="Models to fit on a log, separated by commas.")
    ] = "anarx",
    model: ModelOption = None,
    dims: DimsOption = 2,
    rate: RateOption = 10.0,
    seed: SeedOption = 0,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Fit error models on a whole drive and save them.

    SOURCE is a log; or a recipe, which then tells all but --out, --force and --quiet.
    """
    from navlearn.experiment import train_recipe
    from navlearn.recipe import load_recipe, recipe_for

    if format is None and _is_recipe(source):
        recipe = load_recipe(source)
    else:
        recipe = recipe_for(
            source,
            format,
            methods=split_words(methods),
            models=model or (),
            mechanization={"dims": dims, "rate_hz": rate},
            seed=seed,
        )
    result = train_recipe(recipe, out, force=force, progress=not quiet)
    for name, learned in result.models.items():
        record, verdict = learned.fitted.record, learned.verdict
        typer.echo(
            f"{name}: {record.samples} samples, {record.iterations} iterations; "
            f"{100.0 * verdict.improvement:+.1f} % better on {verdict.replays} emulated outages "
            f"that it had not seen, so its gate would {'' if verdict.use else 'not '}let it act"
        )
    typer.echo(f"Models: {result.folder / 'models'}")


def _is_recipe(source: Path) -> bool:
    """Return whether a YAML file is a recipe, which names a log, and not a descriptor."""
    from navlearn.recipe.yaml_file import read_yaml

    if source.suffix.lower() not in {".yaml", ".yml"}:
        return False
    return "path" not in read_yaml(source, what="recipe or descriptor").content
