"""``navlearn evaluate``: the main job on a log, without a recipe file."""

from pathlib import Path
from typing import Annotated, Any

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
    SensorsOption,
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
        str,
        typer.Option(
            "--methods",
            help="Methods to compare, separated by commas; `navlearn methods` lists all.",
        ),
    ] = "dead_reckoning,ekf_plain,ekf,anarx",
    model: ModelOption = None,
    warm_up: Annotated[
        float, typer.Option("--warm-up", help="No outage starts before this time, s.")
    ] = 300.0,
    placement: Annotated[
        str, typer.Option("--placement", help="spread, random (by --seed) or by_dynamics.")
    ] = "spread",
    times: Annotated[
        str | None,
        typer.Option(
            "--times", help="Starts of the outages, s, separated by commas; instead of COUNT."
        ),
    ] = None,
    dims: DimsOption = 2,
    rate: RateOption = 10.0,
    sensors: SensorsOption = "riss",
    seed: SeedOption = 0,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare methods through GNSS outages put into a drive."""
    from navlearn.cli.result import run_and_show
    from navlearn.recipe import recipe_for

    protocol: dict[str, Any] = {"warm_up_s": warm_up, "placement": placement}
    if placement == "random":
        protocol["seed"] = seed
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
        mechanization={"dims": dims, "rate_hz": rate, "sensors": sensors},
        seed=seed,
    )
    run_and_show(recipe, out, force=force, progress=not quiet)
