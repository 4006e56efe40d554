"""``navlearn check``: what is wrong with a drive, before it is used."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import FormatOption


def check(
    log: Annotated[Path, typer.Argument(help="Log file or folder, or a descriptor (.yaml).")],
    format: FormatOption = None,
) -> None:
    """Check a drive log: gaps, units, axes, latencies, scales and biases, with figures.

    Exits with 1 where a finding would ruin a result.
    """
    from navlearn.logs.quality import check_log
    from navlearn.logs.reading import read_log

    report = check_log(read_log(log, format=format))
    typer.echo(report.to_text())
    if not report.ok:
        raise typer.Exit(1)
