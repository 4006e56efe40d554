"""Error models on disk: weights as tensors, everything else as JSON text, no code.

A file is read with ``weights_only``: opening one from a stranger runs nothing.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.errors import ConfigError, LogNotFoundError, OutputExistsError

FORMAT = "navlearn error model 1"

KIND = "anarx"
"""The one kind that can be read back, and so the one that is written."""


def save_error_model(fitted: FittedErrorModel, path: Path, *, force: bool = False) -> None:
    """Write a fitted error model.

    Args:
        fitted: What to write.
        path: File.
        force: Overwrites an existing file.

    Raises:
        OutputExistsError: The file exists and ``force`` is False.
        ConfigError: The model is of a kind that could not be read back.
    """
    path = Path(path)
    if fitted.kind != KIND:
        raise ConfigError(
            f"{path}: models of kind {fitted.kind!r} cannot be saved yet, only {KIND!r}; nothing "
            "was written. Keep the data and options that it was fitted with"
        )
    if path.exists() and not force:
        raise OutputExistsError(f"{path}: exists already; pass force=True to overwrite it")
    about = {
        "format": FORMAT,
        "kind": fitted.kind,
        "options": asdict(fitted.options),
        "record": asdict(fitted.record),
        "curves": asdict(fitted.curves),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"about": json.dumps(about), "weights": fitted.model.state_dict()}, path)


def load_error_model(path: Path) -> FittedErrorModel:
    """Read a fitted error model.

    Args:
        path: File written by ``save_error_model``.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: The file is no error model, or of a kind that is not known here.
    """
    path = Path(path)
    if not path.exists():
        raise LogNotFoundError(f"{path}: no such file; expected a saved error model")
    try:
        content = torch.load(path, weights_only=True)
        about = json.loads(content["about"])
        weights = content["weights"]
    except Exception as error:
        raise ConfigError(
            f"{path}: not a navlearn error model ({type(error).__name__}: {error})"
        ) from error
    if about.get("format") != FORMAT or about.get("kind") != KIND:
        raise ConfigError(
            f"{path}: format {about.get('format')!r}, kind {about.get('kind')!r}; expected "
            f"{FORMAT!r} and {KIND!r}; read it with the navlearn that wrote it"
        )
    options = AnarxOptions(**about["options"])
    model = Anarx(options)
    model.set_variance(weights["variance"])
    model.load_state_dict(weights)
    model.eval()
    return FittedErrorModel(
        kind=about["kind"],
        model=model,
        options=options,
        record=_record(about["record"]),
        curves=TrainingCurves(**{k: tuple(v) for k, v in about["curves"].items()}),
    )


def _record(content: dict[str, Any]) -> TrainingRecord:
    """Return a record from JSON, lists turned back into tuples."""
    source: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in content["source"].items()
    }
    rest = {k: v for k, v in content.items() if k not in ("source", "time_span", "versions")}
    return TrainingRecord(
        source=TrainingSource(**source),
        time_span=(content["time_span"][0], content["time_span"][1]),
        versions=tuple((name, version) for name, version in content["versions"]),
        **rest,
    )
