"""``navlearn allan``: the noise of an IMU by the Allan variance of a standstill."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navlearn.cli.arguments import ForceOption, FormatOption

if TYPE_CHECKING:
    from navlearn.logs.allan.standstill_noise import StandstillNoise
    from navlearn.logs.drive_log import DriveLog
    from navlearn.outages.output import OutputFolder


def allan(
    log: Annotated[Path, typer.Argument(help="Log file or folder, or a descriptor (.yaml).")],
    format: FormatOption = None,
    start: Annotated[
        float | None,
        typer.Option("--from", help="Where the car begins to stand, s; else its longest stop."),
    ] = None,
    stop: Annotated[float | None, typer.Option("--until", help="Where it drives off, s.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for tables, plot and tuned specs; else none is made."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Read white noise, bias instability and random walk of gyros and accelerometers off a log.

    With 95 % intervals of confidence. With --out it writes the curves, a plot, and tuned specs
    with which a filter can start: tuned_riss.yaml of the z gyro, tuned_imu.yaml of all six axes.
    """
    from navlearn.logs.allan.standstill_noise import standstill_noise
    from navlearn.logs.reading import read_log
    from navlearn.outages.output import prepare_output_folder

    drive = read_log(log, format=format)
    found = standstill_noise(drive, start=start, stop=stop)
    _show(found)
    if out is not None:
        _write(prepare_output_folder(out, force=force), drive, found)
        typer.echo(f"Results: {out}")


def _show(found: "StandstillNoise") -> None:
    from navlearn.outages.allan_plots import allan_table

    stretch = found.stretch
    typer.echo(
        f"{found.log}: {stretch.length:.0f} s at rest, {stretch.start:.1f} to {stretch.stop:.1f} "
        f"s, {found.rate_hz:.4g} Hz"
    )
    table = allan_table(found)
    typer.echo(f"{'axis':8}  {'coefficient':16}  {'value':>9}  {'95 % interval':>21}  unit")
    for row in table.to_dict("records"):
        shown = math.isfinite(row["value"])
        low, high = f"{row['low']:.3g}", f"{row['high']:.3g}"
        value = f"{row['value']:.3g}" if shown else "-"
        interval = f"{low} to {high}" if shown else f"below {high}"
        typer.echo(
            f"{row['axis']:8}  {row['coefficient']:16}  {value:>9}  {interval:>21}  {row['unit']}"
        )
    for one in found.axes:
        for note in one.notes:
            typer.echo(f"{one.axis}: {note}")
    for axis, why in found.left_out.items():
        typer.echo(f"{axis}: left out: {why}")


def _write(folder: "OutputFolder", drive: "DriveLog", found: "StandstillNoise") -> None:
    from navlearn.outages.allan_plots import allan_table, curve_table, plot_allan
    from navlearn.outages.canvas import plots_possible

    allan_table(found).to_csv(folder.claim("noise.csv"), index=False)
    curve_table(found).to_csv(folder.claim("allan.csv"), index=False)
    if plots_possible():
        plot_allan(folder.claim("allan.png"), found)
    else:
        typer.echo("No plot: matplotlib is not installed: pip install 'navlearn[report]'", err=True)
    _write_specs(folder, drive, found)
    folder.finish()


def _write_specs(folder: "OutputFolder", drive: "DriveLog", found: "StandstillNoise") -> None:
    """Write what a filter can start with, for either kind of filter where all is told."""
    from navlearn.errors import FitError
    from navlearn.learning.allan_start import allan_values
    from navlearn.logs.origin import drive_name
    from navlearn.outages.store import log_fingerprint
    from navlearn.recipe.tuned_spec import TunedOn, TunedSpec, write_tuned

    stretch = found.stretch
    made_from = TunedOn(
        log=drive_name(drive.metadata),
        fingerprint=log_fingerprint(drive),
        from_s=stretch.start,
        until_s=stretch.stop,
    )
    for sensors in ("riss", "imu"):
        try:
            values = allan_values(found, sensors=sensors)
        except FitError as problem:
            typer.echo(f"No tuned_{sensors}.yaml: {problem}", err=True)
            continue
        spec = TunedSpec(
            name=f"allan_{sensors}",
            method="allan",
            sensors=sensors,
            filter=values.filter,
            made_from=(made_from,),
            figures=values.figures,
            notes=values.notes,
        )
        write_tuned(folder.claim(f"tuned_{sensors}.yaml"), spec, replace=True)
