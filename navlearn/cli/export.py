"""``navlearn export``: a predictor out of a run."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.cli.arguments import ForceOption
from navlearn.errors import ConfigError, LogNotFoundError


def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    to: Annotated[
        Path, typer.Option("--to", help="File: .pt for TorchScript, .pt2 for torch.export.")
    ],
    model: Annotated[str, typer.Option("--model", help="Name of the model.")] = "anarx",
    force: ForceOption = False,
) -> None:
    """Write a fitted model as a predictor, compared with the model on the run's own data."""
    if to.suffix not in {".pt", ".pt2"}:
        raise ConfigError(f"--to {to}: name the file .pt for TorchScript or .pt2 for torch.export")
    fitted_file = _model_file(run, model)
    from navlearn.error_models.storage import load_error_model
    from navlearn.export import export_predictor
    from navlearn.export.example import load_example

    report = export_predictor(
        load_error_model(fitted_file),
        to,
        check_inputs=load_example(fitted_file.with_name(f"{model}_example.pt")),
        force=force,
        kind="torchscript" if to.suffix == ".pt" else "torch_export",
    )
    typer.echo(f"Largest difference from the model on {report.rows} rows of the run:")
    for what, difference in report.differences.items():
        typer.echo(f"  {what}: {difference:.2g}")
    typer.echo(f"Predictor: {report.path}")


def _model_file(run: Path, model: str) -> Path:
    """Return the file of a run's model, or say which models there are."""
    folder = run / "models"
    path = folder / f"{model}.pt"
    if path.is_file():
        return path
    if not folder.is_dir():
        raise LogNotFoundError(f"{run}: no run with models; make one with navlearn run or train")
    found = [file.stem for file in sorted(folder.glob("*.pt")) if not _is_example(file)]
    raise LogNotFoundError(
        f"{folder}: no model {model!r}; found {', '.join(found) or 'none'}: name one with --model"
    )


def _is_example(file: Path) -> bool:
    return file.stem.endswith("_example")
