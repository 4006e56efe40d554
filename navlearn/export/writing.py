"""Exporting a fitted error model; no file appears before it has been read back and compared."""

import copy
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel
from navlearn.errors import ConfigError, FitError, OutputExistsError, ShapeError
from navlearn.export.metadata import describe
from navlearn.export.predictor import Predictor, ScannedWindow
from navlearn.export.quiet import without_retirement_notice
from navlearn.export.reading import METADATA_FILE, Kind, LoadedPredictor, load_predictor

TOLERANCE: Final = 1e-12
"""Largest difference from eager, as a share of the largest correction or of 1 in its unit."""


@dataclass(frozen=True, kw_only=True)
class ExportReport:
    """What an export wrote and how it compared.

    Attributes:
        path: The file.
        kind: ``torchscript`` or ``torch_export``.
        rows: Rows of input that it was compared on.
        differences: Largest difference from eager by what was compared, as a share of the
            largest correction or of 1 in its unit, whichever is larger.
    """

    path: Path
    kind: Kind
    rows: int
    differences: dict[str, float]


def export_predictor(
    fitted: FittedErrorModel,
    path: str | Path,
    *,
    check_inputs: Tensor,
    force: bool = False,
    kind: Kind = "torchscript",
) -> ExportReport:
    """Write a predictor that runs without navlearn, after comparing it with eager.

    ``torchscript`` offers ``initial_state``, ``step``, ``forward`` and ``prediction_variance``.
    ``torch_export`` holds the windowed ``forward(u)`` for any batch and length from a zero
    start; it has no methods beside it, so streaming stays with TorchScript.

    Args:
        fitted: The model with its record.
        path: File to write; ``.pt`` for TorchScript, ``.pt2`` for ``torch.export``.
        check_inputs: Real inputs to compare on, shape (T, m) with T at least 4.
        force: Whether an earlier file may be overwritten.
        kind: Format.

    Returns:
        What was written and how closely it agrees.

    Raises:
        OutputExistsError: The file exists and ``force`` is False.
        ShapeError: The inputs to check with do not fit the model.
        ConfigError: The record does not name the model's channels, or the format is unknown.
        FitError: The predictor differs from eager, or this torch cannot export it; nothing was
            written.
    """
    path = Path(path)
    if path.exists() and not force:
        raise OutputExistsError(
            f"{path}: exists already; choose another name or replace it (--force)"
        )
    if kind not in ("torchscript", "torch_export"):
        raise ConfigError(f"export: unknown format {kind!r}; choose torchscript or torch_export")
    metadata = describe(fitted)
    inputs = _checked(check_inputs, len(metadata.inputs))
    predictor = Predictor(fitted.model, metadata.to_json()).eval()
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        draft = Path(folder) / f"draft{'.pt' if kind == 'torchscript' else '.pt2'}"
        if kind == "torchscript":
            with without_retirement_notice():
                scripted: Any = torch.jit.script(predictor)
                scripted.save(str(draft))
        else:
            _save_torch_export(predictor, inputs, draft)
        differences = compare(predictor, load_predictor(draft), inputs)
        _refuse_difference(differences, path)
        os.replace(draft, path)
    return ExportReport(path=path, kind=kind, rows=inputs.shape[0], differences=differences)


def _checked(inputs: Tensor, channels: int) -> Tensor:
    if inputs.ndim != 2 or inputs.shape[0] < 4 or inputs.shape[1] != channels:
        raise ShapeError(
            f"check_inputs has shape {tuple(inputs.shape)}; expected (T, {channels}) with at "
            "least 4 rows"
        )
    if not bool(torch.isfinite(inputs).all()):
        raise ShapeError("check_inputs holds values that are not finite; give real inputs")
    return inputs.double()


def _save_torch_export(predictor: Predictor, inputs: Tensor, path: Path) -> None:
    example = torch.stack([inputs, inputs])
    dynamic = ({0: torch.export.Dim("batch"), 1: torch.export.Dim("time")},)
    # Frozen: a scan over what has gradients looks at them and warns.
    window = ScannedWindow(copy.deepcopy(predictor.model)).eval().requires_grad_(False)
    try:
        program = torch.export.export(window, (example,), dynamic_shapes=dynamic)
    except Exception as problem:
        raise FitError(
            f"torch.export of torch {torch.__version__} cannot write this model "
            f"({type(problem).__name__}); export it as TorchScript (.pt)"
        ) from problem
    torch.export.save(program, path, extra_files={METADATA_FILE: predictor.metadata})


@torch.no_grad()
def compare(predictor: Predictor, loaded: LoadedPredictor, inputs: Tensor) -> dict[str, float]:
    """Return the largest differences between a predictor read back and eager.

    Args:
        predictor: The eager predictor.
        loaded: The same, read back from its file.
        inputs: Real inputs, shape (T, m).
    """
    half = inputs.shape[0] // 2
    batch = torch.stack([inputs[:half], inputs[half : 2 * half]])
    window = inputs.unsqueeze(0)
    eager = predictor(window)
    found = {
        "forward": _difference(loaded.module(window), eager),
        "batched forward": _difference(loaded.module(batch), predictor(batch)),
    }
    if loaded.kind == "torchscript":
        state, same = loaded.module.initial_state(inputs[0]), predictor.initial_state(inputs[0])
        rows: list[Tensor] = []
        expected: list[Tensor] = []
        for row in inputs:
            y, state = loaded.module.step(row, state)
            y_eager, same = predictor.step(row, same)
            rows.append(y)
            expected.append(y_eager)
        found["step"] = _difference(torch.stack(rows), torch.stack(expected))
        found["step against forward"] = _difference(torch.stack(rows), eager[0])
    return found


def _difference(found: Tensor, expected: Tensor) -> float:
    if found.shape != expected.shape or not bool(torch.isfinite(found).all()):
        return float("inf")
    return float((found - expected).abs().max() / expected.abs().max().clamp(min=1.0))


def _refuse_difference(differences: dict[str, float], path: Path) -> None:
    for name, difference in differences.items():
        if not difference <= TOLERANCE:
            raise FitError(
                f"{path}: not written: {name} of the exported predictor differs from the model by "
                f"{difference:.3g} (allowed {TOLERANCE:g}); the model does not script faithfully"
            )
