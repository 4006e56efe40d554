"""``navlearn evaluate``: the main job on a log, without a recipe file."""

from pathlib import Path
from typing import Annotated, Any

import typer

from navlearn.cli.arguments import (
    ForceOption,
    FormatOption,
    QuietOption,
    RunFolderOption,
    split_numbers,
    split_words,
)


def evaluate(
    log: Annotated[Path, typer.Argument(help="Log file or folder, or a descriptor (.yaml).")],
    out: RunFolderOption,
    format: FormatOption = None,
    outages: Annotated[
        str, typer.Option("--outages", help="Count and length in seconds, COUNTxSECONDS.")
    ] = "10x60",
    methods: Annotated[
        str, typer.Option("--methods", help="Methods to compare, separated by commas.")
    ] = "dead_reckoning,ekf_plain,ekf,anarx",
    model: Annotated[
        list[Path] | None,
        typer.Option("--model", help="Model spec (.yaml) of a method; may be given repeatedly."),
    ] = None,
    warm_up: Annotated[
        float, typer.Option("--warm-up", help="No outage starts before this time, s.")
    ] = 300.0,
    times: Annotated[
        str | None,
        typer.Option("--times", help="Starts of the outages, s, instead of spreading them."),
    ] = None,
    dims: Annotated[int, typer.Option("--dims", help="2 or 3: plane or with tilt.")] = 2,
    seed: Annotated[int, typer.Option("--seed", help="Seed of all that is drawn.")] = 0,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare methods through GNSS outages put into a drive."""
    from navlearn.cli.result import run_and_show
    from navlearn.recipe import recipe_for

    protocol: dict[str, Any] = {"warm_up_s": warm_up}
    if times is not None:
        starts = split_numbers(times, option="--times")
        protocol |= {"placement": "listed", "times_s": starts, "count": len(starts)}
    recipe = recipe_for(
        log,
        format,
        outages=outages,
        methods=split_words(methods),
        models=model or (),
        outage_options=protocol,
        mechanization={"dims": dims},
        seed=seed,
    )
    run_and_show(recipe, out, force=force, progress=not quiet)
