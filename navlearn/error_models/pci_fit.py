"""Fit of a parallel cascade model: candidates in batches, the best that passes is added.

Source: [Iqbal2020, IV] after [Korenberg1991], with batches, several inputs, weights, an
acceptance test that counts what was fitted, and a common refit of all polynomials beyond them.
"""

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
from navlearn.error_models.pci_candidates import (
    Cascades,
    acceptance_threshold,
    basis,
    draw_candidates,
    effective_rows,
    fit_cascades,
    linear_responses,
)
from navlearn.error_models.pci_options import PciOptions
from navlearn.error_models.scaling import Scaling, fit_scaling
from navlearn.errors import FitError, ShapeError


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
    inputs, output = fit_scaling(x, weight), fit_scaling(y.unsqueeze(-1), weight)
    lagged, target, counts = _rows(x, y, weight, options.lags, inputs, output)
    share = counts / counts.sum()
    rows = float(counts.sum() ** 2 / (counts * counts).sum())
    cascades, curve, tried, stopped = _build(lagged, target, share, rows, options)
    model = PciModel(options)
    model.set_scaling(inputs, output)
    model.set_cascades(cascades)
    found = cascades.response.shape[0]
    left = max(rows - found * (options.degree + 1), 1.0)
    model.variance = curve[-1] * rows / left * output.scale**2
    model.eval()
    source = source or TrainingSource()
    record = TrainingRecord(
        source=source,
        time_span=(0.0, (x.shape[-2] - 1) * source.time_step),
        samples=int(target.shape[0]),
        validation_samples=0,
        trainer="pci",
        loop="open",
        iterations=found,
        stopped=stopped,
        seed=options.seed,
        train_loss=curve[-1],
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
        curves=TrainingCurves(train=tuple(curve), valid=()),
        tried=tried,
        cascades=found,
    )


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
    """Return lagged inputs (N, (R + 1) m) by lag, then channel, outputs and weights (N,)."""
    if x.shape[-2] <= lags:
        raise FitError(f"windows of {x.shape[-2]} rows are too short for {lags} lags")
    z = (x - inputs.mean) / inputs.scale
    target = ((y - output.mean) / output.scale)[..., lags:].reshape(-1)
    lagged = z.unfold(-2, lags + 1, 1).flip(-1).transpose(-1, -2)
    whole = (weight > 0.0).unfold(-1, lags + 1, 1).all(-1).reshape(-1)
    if not bool(whole.any()):
        raise FitError(f"no row has {lags} rows of positive weight before it")
    lagged = lagged.reshape(-1, (lags + 1) * x.shape[-1])[whole]
    return lagged, target[whole], weight[..., lags:].reshape(-1)[whole]


def _build(
    lagged: Tensor, target: Tensor, share: Tensor, rows: float, options: PciOptions
) -> tuple[Cascades, list[float], int, str]:
    """Return the cascades, the residual power after each, candidates tried and why it ended."""
    generator = torch.Generator().manual_seed(options.seed)
    empty, _ = fit_cascades(lagged, target, share, torch.zeros_like(lagged[:1]), options.degree)
    model = Cascades(*(field[:0] for field in empty))
    residual, tried = target, 0
    start = float((share * target * target).sum())
    curve = [start]
    while True:
        if curve[-1] <= options.target:
            return model, curve, tried, "target"
        if model.response.shape[0] >= options.cascades:
            return model, curve, tried, "cascades"
        if tried >= options.tried:
            return model, curve, tried, "tried"
        count = min(options.batch, options.tried - tried)
        tried += count
        best = _best(lagged, residual, share, rows, count, curve[-1] / start, options, generator)
        if best is None:
            return model, curve, tried, "none passed"
        model = Cascades(*(torch.cat(pair) for pair in zip(model, best, strict=True)))
        values = basis(lagged @ model.response.T, model.shift, model.norm)
        if options.refit:
            model = model._replace(weight=_refit(values, target, share))
        residual = target - (values * model.weight).sum((-1, -2))
        curve.append(float((share * residual * residual).sum()))


def _best(
    lagged: Tensor,
    residual: Tensor,
    share: Tensor,
    rows: float,
    count: int,
    c: float,
    options: PciOptions,
    generator: torch.Generator,
) -> Cascades | None:
    """Return the candidate that explains most of the residual, if it passes the test."""
    draw = draw_candidates(count, options.order, options.lags, options.inputs, generator)
    response = linear_responses(lagged, residual, share, c, draw)
    fitted, power = fit_cascades(lagged, residual, share, response, options.degree)
    freedom = draw.reads.sum(-1).double() + options.degree
    paper = options.acceptance == "paper"
    if not paper:
        rows = effective_rows(rows, lagged[:, : options.inputs], residual, share)
    least = acceptance_threshold(rows, freedom, count, options.level, paper)
    passes = power > least * (share * residual * residual).sum()
    if not bool(passes.any()):
        return None
    k = int(torch.where(passes, power, -torch.ones_like(power)).argmax())
    return Cascades(*(field[k : k + 1] for field in fitted))


def _refit(values: Tensor, target: Tensor, share: Tensor) -> Tensor:
    """Return the coefficients of all polynomials together, the shortest of the best fits."""
    root = share.sqrt()
    columns = root.unsqueeze(-1) * values.flatten(1)
    solution = torch.linalg.lstsq(columns, (root * target).unsqueeze(-1), driver="gelsd")
    weight: Tensor = solution.solution.reshape(values.shape[1:])
    return weight
