"""``navlearn simulate``: a drive with known truth and named sensors."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import ForceOption


def simulate(
    out: Annotated[Path, typer.Option("--out", help="Folder for the log.")],
    profile: Annotated[
        str,
        typer.Option(
            "--profile", help="Kind of drive: town, suburb, motorway, hills, commute or mixed."
        ),
    ] = "mixed",
    grade: Annotated[
        str, typer.Option("--grade", help="Sensor grade: tactical, mems_l, mems_m, mems_x, ideal.")
    ] = "mems_m",
    duration: Annotated[float, typer.Option("--duration", help="Length of the drive, s.")] = 1800.0,
    seed: Annotated[int, typer.Option("--seed", help="Seed of all that is drawn.")] = 0,
    satellites: Annotated[
        str | None,
        typer.Option(
            "--satellites",
            help="Sky that raw ranges are received from: open_sky, suburban, urban or ideal; "
            "without it there are none.",
        ),
    ] = None,
    sample: Annotated[
        bool,
        typer.Option(
            "--sample", help="Make the drive that ships in datasets/; only --out and --force count."
        ),
    ] = False,
    force: ForceOption = False,
) -> None:
    """Simulate a drive and save it as a log with its truth as reference.

    What only a simulation knows of its gyro and its ranges lies beside it, for oracles.
    """
    from navlearn.logs.formats.native import save_log
    from navlearn.logs.synthetic.sample import make_sample_drive
    from navlearn.logs.synthetic.simulate import simulate_drive

    if sample:
        folder = make_sample_drive(out, force=force)
    else:
        drive = simulate_drive(
            profile=profile, grade=grade, duration=duration, seed=seed, satellites=satellites
        )
        folder = save_log(
            drive.log,
            out,
            force=force,
            truth=drive.sensor_truth,
            range_truth=drive.range_truth,
        )
    typer.echo(f"Log: {folder}")
