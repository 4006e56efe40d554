"""Predictors read back from their files."""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import torch

from navlearn.errors import ConfigError, LogNotFoundError
from navlearn.export.metadata import PredictorMetadata
from navlearn.export.quiet import without_retirement_notice

Kind = Literal["torchscript", "torch_export"]
METADATA_FILE: Final = "navlearn_metadata.json"


@dataclass(frozen=True, kw_only=True)
class LoadedPredictor:
    """A predictor and what it says about itself.

    Attributes:
        module: Callable on windows of inputs (B, T, m); a TorchScript module also has
            ``initial_state``, ``step`` and ``prediction_variance``.
        metadata: What the file says about it.
        kind: Format of the file.
    """

    module: Any
    metadata: PredictorMetadata
    kind: Kind


def load_predictor(path: str | Path) -> LoadedPredictor:
    """Read a predictor of either format.

    Args:
        path: File written by :func:`navlearn.export.export_predictor`.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: The file is no navlearn predictor.
    """
    path = Path(path)
    if not path.is_file():
        raise LogNotFoundError(f"{path}: there is no such predictor file; check the path")
    if not zipfile.is_zipfile(path):  # torch would print a traceback of its own
        raise ConfigError(
            f"{path}: neither a TorchScript nor a torch.export predictor (no archive, or cut off); "
            "make one with navlearn export"
        )
    try:
        module, text = _load_torchscript(path)
        kind: Kind = "torchscript"
    except RuntimeError as problem:
        try:
            module, text = _load_torch_export(path)
            kind = "torch_export"
        except Exception:
            reason = str(problem).strip().splitlines()[0]
            raise ConfigError(
                f"{path}: neither a TorchScript nor a torch.export predictor ({reason}); make one "
                "with navlearn export"
            ) from None
    try:
        return LoadedPredictor(module=module, metadata=PredictorMetadata.from_json(text), kind=kind)
    except ConfigError as problem:
        raise ConfigError(f"{path}: {problem}") from None


def _load_torchscript(path: Path) -> tuple[Any, str]:
    with without_retirement_notice():
        module: Any = torch.jit.load(str(path), map_location="cpu")  # type: ignore[no-untyped-call]
    return module, str(getattr(module, "metadata", ""))


def _load_torch_export(path: Path) -> tuple[Any, str]:
    files = {METADATA_FILE: ""}
    program = torch.export.load(path, extra_files=files)
    return program.module(), str(files[METADATA_FILE])
