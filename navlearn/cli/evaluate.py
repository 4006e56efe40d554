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
from navlearn.errors import ConfigError


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
    satellites: Annotated[
        int | None,
        typer.Option(
            "--satellites", min=0, help="Satellites whose raw ranges stay; none if left out."
        ),
    ] = None,
    visible: Annotated[
        str | None,
        typer.Option(
            "--visible",
            help="Which of them: highest, best_geometry, worst_geometry, random (by --seed), or "
            "names separated by commas, such as G07,G12.",
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
    if "random" in (placement, visible):
        protocol["seed"] = seed
    if times is not None:
        starts = split_numbers(times, option="--times")
        protocol |= {"placement": "listed", "times_s": starts, "count": len(starts)}
    protocol |= _satellites(satellites, visible)
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


def _satellites(count: int | None, visible: str | None) -> dict[str, Any]:
    """Return how many satellites stay, and the rule or the names that tell which."""
    stay = {} if count is None else {"satellites": count}
    if visible is None:
        return stay
    if any(character.isdigit() for character in visible):
        return {**stay, "visible": "listed", "visible_satellites": split_words(visible)}
    if count is None:
        raise ConfigError(
            f"--visible {visible} tells which satellites stay; add --satellites COUNT"
        )
    return {**stay, "visible": visible}
