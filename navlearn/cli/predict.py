"""``navlearn predict``: a predictor on a log between two times."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import ForceOption, FormatOption
from navlearn.errors import OutputExistsError


def predict(
    predictor: Annotated[Path, typer.Argument(help="Predictor made by navlearn export.")],
    log: Annotated[Path, typer.Argument(help="Log file or folder, or a descriptor (.yaml).")],
    start: Annotated[float, typer.Option("--from", help="Last time with GNSS, s.")],
    stop: Annotated[float, typer.Option("--to", help="End of the prediction, s.")],
    out: Annotated[Path, typer.Option("--out", help="Table to write (.csv).")],
    format: FormatOption = None,
    force: ForceOption = False,
) -> None:
    """Run a predictor on a log as if GNSS were gone between two times."""
    if out.exists() and not force:
        raise OutputExistsError(f"{out}: exists already; choose another name or --force")
    from navlearn.export import load_predictor, predict_drive
    from navlearn.logs.reading import read_log

    loaded = load_predictor(predictor)
    table = predict_drive(loaded, read_log(log, format=format), start=start, stop=stop)
    out.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(out, index=False)
    typer.echo(f"Predictions: {out} ({len(table)} rows)")
