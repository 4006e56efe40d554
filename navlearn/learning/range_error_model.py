"""Range-error models: fitted to the past of the satellites that stay, run through the outage.

Source: [Iqbal2020] §IX for parallel cascades per satellite; FOS and ANARX take the same place.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.errors import FitError
from navlearn.learning.range_error_fits import Predicted, by_anarx, by_fos, by_pci
from navlearn.learning.range_error_options import RangeErrorOptions
from navlearn.learning.range_level import (
    fit_gauss_markov,
    last_values,
    predict_gauss_markov,
    recent_mean,
)
from navlearn.learning.range_residuals import CHANNELS, HELD, ResidualSeries
from navlearn.learning.range_windows import RangeWindows, inputs_ahead, past_windows


class RangeErrors(NamedTuple):
    """Predicted range errors of S satellites through an outage of H rows.

    Attributes:
        error: To be taken off the pseudorange, m, zero where nothing is predicted, shape (H, S).
        variance: Of what remains, m², zero where nothing is predicted, shape (H, S).
        known: Satellites that something was predicted for, bool, shape (S,).
        taught: Satellites that were learned from, bool, shape (S,).
        fitted: The models, one per satellite taught, or one of all; only of
            ``pci``, ``fos`` and ``anarx``.
        outside: Rows ahead in which an input left its training range.
        inputs: What each model ran on through the outage, shape (n, H, m); of a model of all
            satellites what it ran on for each.
    """

    error: Tensor
    variance: Tensor
    known: Tensor
    taught: Tensor
    fitted: tuple[FittedErrorModel, ...]
    outside: int
    inputs: Tensor


@torch.no_grad()
def predict_range_errors(
    series: ResidualSeries,
    visible: Tensor,
    options: RangeErrorOptions,
    source: TrainingSource | None = None,
) -> RangeErrors:
    """Fit to the past of the satellites that stay visible, and predict through the outage.

    Args:
        series: Residuals before the outage, inputs through it.
        visible: Satellites that stay, bool, shape (S,).
        options: What is learned.
        source: What else is known about the data, for the record.

    Raises:
        FitError: No satellite that stays has enough of a past.
    """
    every = past_windows(series, torch.arange(len(visible)), options)
    rows = torch.isfinite(every.target).sum(-1)
    enough = rows >= max(options.fewest_rows, 2 * (options.lags + 1))
    known = visible & enough
    if not bool(known.any()):
        most = int(rows[visible].max()) if bool(visible.any()) else 0
        raise FitError(
            f"range errors: none of {int(visible.sum())} satellites that stay has "
            f"{options.fewest_rows} residuals in the last {options.window_s:g} s ({most} at most);"
            " start the outages later, or ask for fewer"
        )
    taught = enough if options.shared else known
    windows = past_windows(series, torch.nonzero(taught).squeeze(-1), options)
    source = source or range_source(options, series.step)
    found = _PREDICT[options.structure](windows, options, source)
    ahead = windows.ahead.shape[1]
    error = series.target.new_zeros((ahead, len(visible)))
    variance = error.clone()
    error[:, taught], variance[:, taught] = found.error.T, found.variance.T
    known = known & torch.isfinite(error).all(0)
    return RangeErrors(
        error=torch.where(known, error, 0.0),
        variance=torch.where(known, variance, 0.0),
        known=known,
        taught=taught,
        fitted=found.fitted,
        outside=found.outside,
        inputs=inputs_ahead(windows, options) if options.held_inputs else windows.ahead,
    )


def range_source(
    options: RangeErrorOptions, step: float, logs: tuple[str, ...] = ()
) -> TrainingSource:
    """Return what a record says of a range-error model's training data.

    Args:
        options: What is learned.
        step: Length of a row, s.
        logs: Names of the logs.
    """
    units = {**CHANNELS, **HELD}
    return TrainingSource(
        logs=logs,
        regime="online",
        acts_on="pseudorange",
        inputs=options.inputs,
        outputs=("range_error",),
        time_step=step,
        input_units=tuple(units[name][0] for name in options.inputs),
    )


def _limited(error: Tensor, windows: RangeWindows, options: RangeErrorOptions) -> Tensor:
    """Return predictions within a multiple of each satellite's own deviation about its mean."""
    if not options.bounds:
        return error
    there = torch.isfinite(windows.target)
    count = there.sum(-1, keepdim=True).clamp(min=1)
    y = torch.where(there, windows.target, 0.0)
    mean = y.sum(-1, keepdim=True) / count
    spread = (torch.where(there, y - mean, 0.0).square().sum(-1, keepdim=True) / count).sqrt()
    reach = options.output_limit * spread
    return torch.minimum(torch.maximum(error, mean - reach), mean + reach)


def _held(windows: RangeWindows, options: RangeErrorOptions, _: TrainingSource) -> Predicted:
    last = last_values(windows.target).unsqueeze(-1)
    if options.average_s > 0.0:
        last = recent_mean(windows.target, options.average_s / windows.step)[:, -1:]
    error = _limited(last.expand(-1, windows.ahead.shape[1]), windows, options)
    off = torch.where(torch.isfinite(windows.target), windows.target - last, 0.0)
    count = torch.isfinite(windows.target).sum(-1, keepdim=True)
    return Predicted(error, (off.square().sum(-1, keepdim=True) / count).expand_as(error))


def _none(windows: RangeWindows, _: RangeErrorOptions, __: TrainingSource) -> Predicted:
    there = torch.isfinite(windows.target)
    square = torch.where(there, windows.target, 0.0).square().sum(-1, keepdim=True)
    shape = (windows.target.shape[0], windows.ahead.shape[1])
    variance = (square / there.sum(-1, keepdim=True)).expand(shape)
    return Predicted(torch.zeros_like(variance), variance)


def _decay(windows: RangeWindows, options: RangeErrorOptions, _: TrainingSource) -> Predicted:
    process = fit_gauss_markov(windows.target)
    error, variance = predict_gauss_markov(process, windows.target, windows.ahead.shape[1])
    return Predicted(_limited(error, windows, options), variance)


_PREDICT: Final[
    dict[str, Callable[[RangeWindows, RangeErrorOptions, TrainingSource], Predicted]]
] = {"pci": by_pci, "fos": by_fos, "anarx": by_anarx, "held": _held, "decay": _decay, "none": _none}
