"""Fit of parallel cascade models to one record, or to each of many windows at once."""

import platform
from dataclasses import dataclass

import torch
from torch import Tensor

import navlearn
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.pci import PciModel
from navlearn.error_models.pci_build import build_cascades
from navlearn.error_models.pci_candidates import Cascades
from navlearn.error_models.pci_options import PciOptions
from navlearn.error_models.pci_windows import Built, Rows
from navlearn.error_models.scaling import Scaling, fit_scaling
from navlearn.errors import FitError, ShapeError

HELD = 2**18
"""Values of one table of candidates by rows, over the windows that are treated at once."""


@dataclass(frozen=True, kw_only=True)
class FittedPci(FittedErrorModel):
    """A parallel cascade model with its record.

    Attributes:
        tried: Number of candidates that were tried.
        cascades: Number of cascades in the model.
    """

    tried: int
    cascades: int


@torch.no_grad()
def fit_pci(
    x: Tensor,
    y: Tensor,
    options: PciOptions,
    weight: Tensor | None = None,
    *,
    source: TrainingSource | None = None,
) -> FittedPci:
    """Fit parallel cascades from inputs to an output.

    A row counts when it and the R rows before it have positive weight, so that no memory reaches
    across a gap or the start of a window.

    Args:
        x: Inputs in physical units, shape (..., T, m), or (T,) for one channel.
        y: Output in physical units, shape (..., T) or (..., T, 1).
        options: How to build the model.
        weight: Weight of each row, not negative, shape (..., T); rows of weight zero are not
            read. None for equal weights.
        source: What else is known about the data.

    Raises:
        ShapeError: The shapes do not belong together.
        FitError: A row that counts is not finite, or no row has a whole memory behind it.
    """
    x, y, weight = _checked(x, y, options, weight)
    scaling = fit_scaling(x, weight), fit_scaling(y.unsqueeze(-1), weight)
    lagged, target, counts = _rows(x, y, weight, options.lags, *scaling)
    rows = _weighted(lagged.flatten(0, -2)[None], target.reshape(1, -1), counts.reshape(1, -1))
    ((cascades, built),) = build_cascades(rows, options)
    return _fitted(cascades, built, rows, 0, scaling, x.shape[-2], options, source)


@torch.no_grad()
def fit_pci_windows(
    x: Tensor,
    y: Tensor,
    options: PciOptions,
    weight: Tensor | None = None,
    *,
    source: TrainingSource | None = None,
) -> list[FittedPci]:
    """Fit a model of its own to each of many windows, all at once.

    The same models as ``fit_pci`` gives window by window, up to rounding.

    Args:
        x: Inputs in physical units, shape (B, T, m).
        y: Outputs in physical units, shape (B, T) or (B, T, 1).
        options: How to build each model.
        weight: Weight of each row, not negative, shape (B, T); None for equal weights.
        source: What else is known about the data.

    Returns:
        A fitted model per window.

    Raises:
        ShapeError: The shapes do not belong together.
        FitError: A row that counts is not finite, or a window has no row with a whole memory.
    """
    if x.ndim != 3:
        raise ShapeError(f"x has shape {tuple(x.shape)}; expected windows (B, T, {options.inputs})")
    x, y, weight = _checked(x, y, options, weight)
    scalings, parts = [], []
    for k in range(x.shape[0]):
        scaling = fit_scaling(x[k], weight[k]), fit_scaling(y[k].unsqueeze(-1), weight[k])
        scalings.append(scaling)
        parts.append(_rows(x[k], y[k], weight[k], options.lags, *scaling))
    size = max(1, HELD // (options.batch * x.shape[-2]))
    fitted = []
    for first in range(0, len(parts), size):
        chunk = parts[first : first + size]
        rows = _weighted(*(torch.stack(part) for part in zip(*chunk, strict=True)))
        fitted += [
            _fitted(cascades, built, rows, k, scalings[first + k], x.shape[-2], options, source)
            for k, (cascades, built) in enumerate(build_cascades(rows, options))
        ]
    return fitted


def _checked(
    x: Tensor, y: Tensor, options: PciOptions, weight: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Return inputs (..., T, m), output (..., T) and weights (..., T) as float64."""
    x = x.unsqueeze(-1) if x.ndim == 1 else x
    if y.shape == (*x.shape[:-1], 1):
        y = y.squeeze(-1)
    weight = torch.ones_like(y) if weight is None else weight
    if x.shape[-1] != options.inputs or y.shape != x.shape[:-1] or weight.shape != y.shape:
        raise ShapeError(
            f"x has shape {tuple(x.shape)}, y {tuple(y.shape)}, weight {tuple(weight.shape)}; "
            f"expected (..., T, {options.inputs}), (..., T) and (..., T)"
        )
    if not bool((weight >= 0.0).all()):
        raise FitError("a weight is negative or NaN; weights must be zero or positive")
    return x.double(), y.double(), weight.double()


def _rows(
    x: Tensor, y: Tensor, weight: Tensor, lags: int, inputs: Scaling, output: Scaling
) -> tuple[Tensor, Tensor, Tensor]:
    """Return lagged inputs (..., N, (R + 1) m) by lag, then channel, outputs and weights (..., N).

    Rows that do not count, for want of weight or of a past, are zero.
    """
    if x.shape[-2] <= lags:
        raise FitError(f"windows of {x.shape[-2]} rows are too short for {lags} lags")
    whole = (weight > 0.0).unfold(-1, lags + 1, 1).all(-1)
    if not bool(whole.any()):
        raise FitError(f"no row has {lags} rows of positive weight before it")
    z = (x - inputs.mean) / inputs.scale
    lagged = z.unfold(-2, lags + 1, 1).flip(-1).transpose(-1, -2).flatten(-2)
    target = ((y - output.mean) / output.scale)[..., lags:]
    lagged = torch.where(whole.unsqueeze(-1), lagged, 0.0)
    return lagged, torch.where(whole, target, 0.0), torch.where(whole, weight[..., lags:], 0.0)


def _weighted(lagged: Tensor, target: Tensor, counts: Tensor) -> Rows:
    """Return the rows of windows (B, N) with the roots of their weights."""
    total = counts.sum(-1, keepdim=True)
    root = (counts / total).sqrt()
    rows = total.squeeze(-1).square() / counts.square().sum(-1)
    return Rows(lagged=lagged, target=root * target, root=root, rows=rows)


def _fitted(
    cascades: Cascades,
    built: Built,
    rows: Rows,
    window: int,
    scaling: tuple[Scaling, Scaling],
    length: int,
    options: PciOptions,
    source: TrainingSource | None,
) -> FittedPci:
    """Return the model of one window with its record."""
    model = PciModel(options)
    model.set_scaling(*scaling)
    model.set_cascades(cascades)
    found, count = len(built.accepted), float(rows.rows[window])
    fitted = found * (options.degree + 1)
    if options.polish:
        fitted += int((model.response != 0.0).sum()) - found
    left = max(count - fitted, 1.0)
    model.variance = built.curve[-1] * count / left * scaling[1].scale ** 2
    model.eval()
    source = source or TrainingSource()
    record = TrainingRecord(
        source=source,
        time_span=(0.0, (length - 1) * source.time_step),
        samples=int((rows.root[window] > 0).sum()),
        validation_samples=0,
        trainer="pci",
        loop="open",
        iterations=found,
        stopped=built.stopped,
        seed=options.seed,
        train_loss=built.curve[-1],
        valid_loss=float("nan"),
        versions=(
            ("navlearn", navlearn.__version__),
            ("torch", str(torch.__version__)),
            ("python", platform.python_version()),
        ),
    )
    return FittedPci(
        kind="pci",
        model=model,
        options=options,
        record=record,
        curves=TrainingCurves(train=tuple(built.curve), valid=()),
        tried=built.tried,
        cascades=found,
    )
