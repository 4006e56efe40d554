"""Fit of FOS: candidates, search, coefficients, and what is known of the result.

Source: [Shen2010] §3. Terms are found one step ahead, on measured outputs; the variance of a
model that feeds its output back is measured in free run. Records of several windows make one
model (``fit_fos``) or a model of each, searched side by side (``fit_fos_batch``).
"""

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.fos_candidates import Candidates, lagged_columns
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_outcome import Outcome, build_fitted, read_outcomes
from navlearn.error_models.fos_refine import exchange_terms, kick_terms, search_backward
from navlearn.error_models.fos_search import search_forward, start_search
from navlearn.error_models.fos_state import Search
from navlearn.errors import FitError, ShapeError


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
    weight = check_weight(y, weight)
    x, target, share = equations(u, y, weight, options, alone=False)
    joined = x.movedim(-2, 0).reshape(1, x.shape[-2], -1)
    found = _search(joined, target.reshape(1, -1), share.reshape(1, -1), options)
    return build_fitted(found[0], u, y, weight, options, source or TrainingSource())


@torch.no_grad()
def fit_fos_batch(
    u: Tensor,
    y: Tensor,
    weight: Tensor | None = None,
    options: FosOptions | None = None,
    source: TrainingSource | None = None,
) -> list[FittedErrorModel]:
    """Fit a sparse polynomial to each window by itself, all at once.

    Every window has its own terms; the results are those of ``fit_fos`` on one window after
    another, in a fraction of the time where windows are short. Memory grows with the windows:
    twice their number times ``max_terms`` times the candidates.

    Args:
        u: Inputs, physical units, shape (B, T, m).
        y: Target, physical units, shape (B, T, 1).
        weight: Weight of each row, not negative, shape (B, T); None for equal weights.
        options: What is searched and when it stops.
        source: What the caller knows about the data, for the record of each.

    Returns:
        One fitted model of each window.

    Raises:
        ShapeError: The shapes do not belong together, or the windows are no longer than the lags.
        FitError: In some window no row counts, or one that counts is not finite.
    """
    options = options or FosOptions()
    weight = check_weight(y, weight)
    if u.ndim != 3:
        raise ShapeError(f"fos: inputs have shape {tuple(u.shape)}; expected windows (B, T, m)")
    found = _search(*equations(u, y, weight, options, alone=True), options)
    source = source or TrainingSource()
    rows = zip(found, u, y, weight, strict=True)
    return [build_fitted(one, a, b, c, options, source) for one, a, b, c in rows]


def finish_search(search: Search) -> None:
    """Search, exchange and drop as the options say."""
    search_forward(search)
    exchange_terms(search)
    kick_terms(search)
    if search.options.backward:
        search_backward(search)


def _search(x: Tensor, target: Tensor, weight: Tensor, options: FosOptions) -> list[Outcome]:
    """Return what was found in each window, (B, c, N), (B, N) and (B, N)."""
    candidates = Candidates(x, weight, options.degree)
    search = start_search(
        candidates.gram_rows,
        candidates.energies(),
        candidates.correlations(target),
        (weight * target.square()).sum(1),
        weight,
        options,
    )
    finish_search(search)
    return read_outcomes(search, candidates, target)


def check_weight(y: Tensor, weight: Tensor | None) -> Tensor:
    """Return the weight of each row of the target, shape (..., T)."""
    if y.ndim < 2 or y.shape[-1] != 1:
        raise ShapeError(f"fos: the target has shape {tuple(y.shape)}; expected (..., T, 1)")
    if weight is None:
        return torch.ones_like(y[..., 0], dtype=torch.float64)
    if weight.shape != y.shape[:-1] or bool((weight < 0).any()):
        raise ShapeError(
            f"fos: weight has shape {tuple(weight.shape)}, target {tuple(y.shape)}; expected "
            "(..., T), nowhere negative"
        )
    return weight.double()


def equations(
    u: Tensor, y: Tensor, weight: Tensor, options: FosOptions, *, alone: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Return columns, target and weight of the rows with a whole past; zeros in rows of no weight.

    Each window needs a row that counts where it is fitted ``alone``. Shapes (..., c, N), (..., N)
    and (..., N).
    """
    x = lagged_columns(u, y[..., 0], options)
    memory = max(options.lags, options.output_lags)
    target, share = y[..., memory:, 0].double(), weight[..., memory:]
    counts = share > 0
    if not bool((counts.any(-1) if alone else counts.any()).all()):
        raise FitError("fos: no row with a whole past has a positive weight; give more rows")
    if not bool(counts.all()):
        x = torch.where(counts.unsqueeze(-2), x, 0.0)
        target = torch.where(counts, target, 0.0)
    if not bool(torch.isfinite(x.sum()) & torch.isfinite(target.sum())):
        raise FitError(
            "fos: a row that counts is not finite, or looks back on one that is not; give weight "
            f"zero to it and to the {memory} rows after it"
        )
    return x, target, share
