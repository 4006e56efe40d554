"""Error models on disk: weights as tensors, everything else as JSON text, no code.

A file is read with ``weights_only``: opening one from a stranger runs nothing. What is special
to a kind of model stands in ``storage_kinds``.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.storage_kinds import KINDS
from navlearn.errors import ConfigError, LogNotFoundError, OutputExistsError

FORMAT = "navlearn error model 1"


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
    if fitted.kind not in KINDS:
        raise ConfigError(
            f"{path}: models of kind {fitted.kind!r} cannot be saved, only {', '.join(KINDS)}; "
            "nothing was written. Keep the data and options that it was fitted with"
        )
    if path.exists() and not force:
        raise OutputExistsError(f"{path}: exists already; pass force=True to overwrite it")
    kind = KINDS[fitted.kind]
    about = {
        "format": FORMAT,
        "kind": fitted.kind,
        "description": kind.describe(fitted.model),
        "record": asdict(fitted.record),
        "curves": asdict(fitted.curves),
        "own": {name: getattr(fitted, name) for name in kind.own},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"about": json.dumps(about), "weights": fitted.model.state_dict()}, path)


def load_error_model(path: Path) -> FittedErrorModel:
    """Read a fitted error model.

    Args:
        path: File written by ``save_error_model``.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: The file is no error model, of a kind that is not known here, or damaged.
    """
    path = Path(path)
    if not path.exists():
        raise LogNotFoundError(f"{path}: no such file; expected a saved error model")
    try:
        content = torch.load(path, weights_only=True)
        about = dict(json.loads(content["about"]))
        weights = content["weights"]
    except Exception as error:
        raise ConfigError(
            f"{path}: not a navlearn error model ({type(error).__name__}: {error})"
        ) from error
    if about.get("format") != FORMAT or about.get("kind") not in KINDS:
        raise ConfigError(
            f"{path}: format {about.get('format')!r}, kind {about.get('kind')!r}; expected "
            f"{FORMAT!r} and one of {', '.join(KINDS)}; read it with the navlearn that wrote it"
        )
    try:
        return _rebuilt(about, weights)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{path}: a model of kind {about['kind']!r} that cannot be rebuilt "
            f"({type(error).__name__}: {error}); save it again"
        ) from error


def _rebuilt(about: dict[str, Any], weights: dict[str, torch.Tensor]) -> FittedErrorModel:
    """Return the model that a file describes."""
    kind = KINDS[about["kind"]]
    # Earlier files hold networks alone, which their options describe.
    description = about["description"] if "description" in about else about["options"]
    model: Any = kind.rebuild(description, weights).eval()
    return kind.fitted(
        kind=about["kind"],
        model=model,
        options=model.options,
        record=_record(about["record"]),
        curves=TrainingCurves(**{k: tuple(v) for k, v in about["curves"].items()}),
        **{name: about["own"][name] for name in kind.own},
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
