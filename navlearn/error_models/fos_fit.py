"""Fit of FOS: candidates, search, coefficients, and what is known of the result.

Source: [Shen2010] §3. Terms are found one step ahead, on measured outputs; the variance of a
model that feeds its output back is measured in free run.
"""

import platform

import torch
from torch import Tensor

import navlearn
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.fos import FosModel
from navlearn.error_models.fos_candidates import build_candidates, factor_list, lagged_columns
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_search import (
    Search,
    exchange_terms,
    search_backward,
    search_forward,
    start_search,
)
from navlearn.error_models.scaling import fit_scaling
from navlearn.errors import FitError, ShapeError

LONGEST_RUN = 60


@torch.no_grad()
def fit_fos(
    u: Tensor,
    y: Tensor,
    weight: Tensor | None = None,
    options: FosOptions | None = None,
    source: TrainingSource | None = None,
) -> FittedErrorModel:
    """Fit a sparse polynomial to records.

    Args:
        u: Inputs, physical units, shape (..., T, m).
        y: Target, physical units, shape (..., T, 1).
        weight: Weight of each row, not negative, shape (..., T); None for equal weights. Rows of
            weight zero are no equations, whatever stands in them.
        options: What is searched and when it stops.
        source: What the caller knows about the data, for the record.

    Returns:
        A ``FosModel`` with its record; the curve is the mean squared residual by
        term, with the ridge's penalty, in standardised units.

    Raises:
        ShapeError: The shapes do not belong together, or the windows are no longer than the lags.
        FitError: No row counts, or a row that counts is not finite or reaches one that is not.
    """
    options = options or FosOptions()
    if y.ndim < 2 or y.shape[-1] != 1:
        raise ShapeError(f"fos: the target has shape {tuple(y.shape)}; expected (..., T, 1)")
    weight = torch.ones_like(y[..., 0]) if weight is None else weight.double()
    if weight.shape != y.shape[:-1] or bool((weight < 0).any()):
        raise ShapeError(
            f"fos: weight has shape {tuple(weight.shape)}, target {tuple(y.shape)}; expected "
            "(..., T), nowhere negative"
        )
    scaling = fit_scaling(u, weight), fit_scaling(y, weight)
    search = _search(u, y[..., 0].double(), weight, options)
    factors = factor_list(u.shape[-1], options)
    terms = tuple(factors[i] + factors[j] for i, j in search.chosen)
    model = FosModel(u.shape[-1], terms, options)
    model.set_fit(search.coefficients(), *scaling)
    free = max(search.effective - len(terms), 1.0)
    count = float(search.candidates.root_weight.square().sum())
    error = _data_error(search) / count
    model.set_variance(torch.full((1, 1), error * search.effective / free, dtype=torch.float64))
    if model.feedback:
        model.set_variance(_free_run_variance(model, u.double(), y.double(), weight))
    model.eval()
    energy = count * float(scaling[1].scale) ** 2
    curve = tuple(value / energy for value in search.errors)
    return FittedErrorModel(
        kind="fos",
        model=model,
        options=options,
        record=_record(search, u, source or TrainingSource(), curve[-1]),
        curves=TrainingCurves(train=curve, valid=()),
    )


def _search(u: Tensor, y: Tensor, weight: Tensor, options: FosOptions) -> Search:
    """Return a finished search over the rows that count."""
    x = lagged_columns(u, y, options)
    memory = max(options.lags, options.output_lags)
    share, target = (v[..., memory:].reshape(-1) for v in (weight, y))
    counts = share > 0
    if not bool(counts.any()):
        raise FitError("fos: no row with a whole past has a positive weight; give more rows")
    if not bool(counts.all()):
        x, share, target = x[:, counts], share[counts], target[counts]
    if not bool(torch.isfinite(x.sum()) & torch.isfinite(target.sum())):
        raise FitError(
            "fos: a row that counts is not finite, or looks back on one that is not; give weight "
            f"zero to it and to the {memory} rows after it"
        )
    search = start_search(build_candidates(x, share, options.degree), target, options)
    search_forward(search)
    exchange_terms(search)
    if options.backward:
        search_backward(search)
    return search


def _data_error(search: Search) -> float:
    """Return the energy of the residual on the data, without the ridge's rows."""
    rows = search.candidates.root_weight.shape[0]
    return float(search.residual[:rows].square().sum())


def _free_run_variance(model: FosModel, u: Tensor, y: Tensor, weight: Tensor) -> Tensor:
    """Return the mean squared error of free runs over the record, by step, shape (H, 1)."""
    past, steps = model.memory, u.shape[-2]
    length = max(1, min(LONGEST_RUN, (steps - past) // 2))
    total, count = torch.zeros(length).double(), torch.zeros(length).double()
    for k in range(past, steps - length + 1, length):
        state = model.warm_state(u[..., k - past : k, :], y[..., k - past : k, :])
        stop = k + length
        error = (model.run(u[..., k:stop, :], state) - y[..., k:stop, :])[..., 0].square()
        share = torch.where(torch.isfinite(error), weight[..., k:stop], 0.0)
        error = torch.where(share > 0, error, 0.0)
        total += (share * error).reshape(-1, length).sum(0)
        count += share.reshape(-1, length).sum(0)
    return torch.where(count > 0, total / count, torch.inf).unsqueeze(1)


def _record(search: Search, u: Tensor, source: TrainingSource, loss: float) -> TrainingRecord:
    """Return what the model was trained on."""
    return TrainingRecord(
        source=source,
        time_span=(0.0, u.shape[:-1].numel() * source.time_step),
        samples=search.candidates.root_weight.shape[0],
        validation_samples=0,
        trainer="fos",
        loop="open",
        iterations=len(search.errors) - 1,
        stopped=search.stopped,
        seed=0,
        train_loss=loss,
        valid_loss=float("nan"),
        versions=(
            ("navlearn", navlearn.__version__),
            ("torch", str(torch.__version__)),
            ("python", platform.python_version()),
        ),
    )
