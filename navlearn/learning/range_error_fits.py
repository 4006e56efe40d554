"""PCI, FOS and ANARX in the place of a range-error model: records, fit, and the run ahead."""

from collections.abc import Callable
from typing import NamedTuple, cast

import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.fos import FosModel
from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.pci import PciModel
from navlearn.error_models.pci_fit import fit_pci
from navlearn.errors import FitError
from navlearn.learning.fit import fit_anarx
from navlearn.learning.range_error_options import RangeErrorOptions
from navlearn.learning.range_windows import RangeWindows, emulated_outages, inputs_ahead
from navlearn.learning.windows import Windows


class Predicted(NamedTuple):
    """What is predicted for n satellites through H rows.

    Attributes:
        error: m, shape (n, H).
        variance: Of what remains, m², shape (n, H).
        fitted: The models, one per satellite or one of all.
        outside: Rows in which an input left its training range.
    """

    error: Tensor
    variance: Tensor
    fitted: tuple[FittedErrorModel, ...] = ()
    outside: int = 0


class _Rows(NamedTuple):
    """Records to fit to, and what the model runs on ahead.

    Attributes:
        inputs: Finite, shape (N, T, m).
        target: Finite, shape (N, T).
        there: 1.0 where inputs and target are, shape (N, T).
        weight: 1.0 where they are through a row's whole memory, shape (N, T).
        ahead: Inputs through the outage, shape (n, H, m).
    """

    inputs: Tensor
    target: Tensor
    there: Tensor
    weight: Tensor
    ahead: Tensor


def _records(windows: RangeWindows, options: RangeErrorOptions) -> _Rows:
    """Return finite records; in emulated outages where the model has inputs of those."""
    inputs, target, ahead = windows.inputs, windows.target, windows.ahead
    if options.held_inputs:
        emulated = emulated_outages(windows, options)
        inputs, target = emulated.inputs, emulated.target
        ahead = inputs_ahead(windows, options)
    whole = torch.isfinite(inputs).all(-1) & torch.isfinite(target)
    memory = max(options.lags, options.output_lags)
    padded = torch.nn.functional.pad(whole.double(), [memory, 0])
    weight = padded.unfold(-1, memory + 1, 1).amin(-1)
    if not bool((weight[..., memory:] > 0).any()):
        raise FitError("range errors: no residual has an unbroken memory; shorten lags")
    fine = torch.where(torch.isfinite(inputs), inputs, 0.0)
    level = torch.where(torch.isfinite(target), target, 0.0)
    return _Rows(fine, level, whole.double(), weight, ahead)


def _one_or_each(
    windows: RangeWindows,
    options: RangeErrorOptions,
    run: Callable[[RangeWindows, _Rows], Predicted],
) -> Predicted:
    """Return predictions of one model of all satellites, or of a model of each."""
    if options.shared:
        return run(windows, _records(windows, options))
    each = [_only(windows, k) for k in range(windows.target.shape[0])]
    parts = [run(part, _records(part, options)) for part in each]
    return Predicted(
        torch.cat([part.error for part in parts]),
        torch.cat([part.variance for part in parts]),
        tuple(model for part in parts for model in part.fitted),
        sum(part.outside for part in parts),
    )


def _only(windows: RangeWindows, k: int) -> RangeWindows:
    one = slice(k, k + 1)
    return RangeWindows(windows.target[one], windows.inputs[one], windows.ahead[one], windows.step)


def by_pci(windows: RangeWindows, options: RangeErrorOptions, source: TrainingSource) -> Predicted:
    """Return what parallel cascades predict.

    Args:
        windows: The pasts of the satellites, and inputs ahead.
        options: What is learned.
        source: For the record.

    Raises:
        FitError: No row can be learned from.
    """

    def run(part: RangeWindows, rows: _Rows) -> Predicted:
        fitted = fit_pci(rows.inputs, rows.target, options.pci_options(), rows.there, source=source)
        model = cast(PciModel, fitted.model)
        u = rows.ahead
        if options.lags and not options.held_inputs:
            u = torch.cat((part.inputs[:, -options.lags :], u), 1)
        error = model(u)[:, u.shape[1] - rows.ahead.shape[1] :, 0]
        return _result(fitted, error, model.count_clamped(rows.ahead))

    return _one_or_each(windows, options, run)


def by_fos(windows: RangeWindows, options: RangeErrorOptions, source: TrainingSource) -> Predicted:
    """Return what a sparse polynomial predicts, on its own output where it is fed back.

    Args:
        windows: The pasts of the satellites, and inputs ahead.
        options: What is learned.
        source: For the record.

    Raises:
        FitError: No row can be learned from.
    """

    def run(part: RangeWindows, rows: _Rows) -> Predicted:
        fitted = fit_fos(
            rows.inputs, rows.target.unsqueeze(-1), rows.weight, options.fos_options(), source
        )
        model = cast(FosModel, fitted.model)
        state = model.initial_state(rows.ahead[:, 0])
        if not options.held_inputs:
            state = model.warm_state(rows.inputs, _carried(part.target).unsqueeze(-1))
        error = model.run(rows.ahead, state)[..., 0]
        return _result(fitted, error, model.count_clamped(rows.ahead))

    return _one_or_each(windows, options, run)


def by_anarx(
    windows: RangeWindows, options: RangeErrorOptions, source: TrainingSource
) -> Predicted:
    """Return what an additive network predicts on its own output.

    Args:
        windows: The pasts of the satellites, and inputs ahead.
        options: What is learned.
        source: For the record.

    Raises:
        FitError: No row can be learned from.
    """

    def run(part: RangeWindows, rows: _Rows) -> Predicted:
        network = options.anarx_options()
        fitted = fit_anarx(
            _free_runs(rows, _carried(part.target), part.step, options),
            None,
            network,
            options.training_options(),
            source=source,
            progress=False,
        )
        model = cast(Anarx, fitted.model)
        measured = _carried(part.target).unsqueeze(-1)
        state = model.warm_state(rows.inputs, measured, measured[:, 0])
        error, _ = model.run(rows.ahead, state)
        return _result(fitted, error[..., 0], model.count_clamped(rows.ahead))

    return _one_or_each(windows, options, run)


def _free_runs(rows: _Rows, measured: Tensor, step: float, options: RangeErrorOptions) -> Windows:
    """Return the records cut into free runs, each warmed up on measured outputs."""
    warmup = max(options.lags, 1)
    length = rows.target.shape[1]
    run = max(1, min(round(options.emulated_s / step), (length - 1 - warmup) // 2))
    starts = torch.arange(1, length - run - warmup + 1, max(1, run // 2))
    index = starts.unsqueeze(-1) + torch.arange(run + warmup)
    weight = rows.weight[:, index].flatten(0, 1).clone()
    weight[:, :warmup] = 0.0
    return Windows(
        rows.inputs[:, index].flatten(0, 1),
        measured[:, index].flatten(0, 1).unsqueeze(-1),
        weight,
        (step * starts.double()).repeat(rows.target.shape[0]),
        measured[:, starts - 1].flatten().unsqueeze(-1),
        warmup,
    )


def _carried(target: Tensor) -> Tensor:
    """Return series whose gaps repeat the value before, zero before the first."""
    place = torch.where(torch.isfinite(target), torch.arange(target.shape[-1]), -1)
    place = torch.cummax(place, -1).values
    return torch.where(place >= 0, target.gather(-1, place.clamp(min=0)), 0.0)


def _result(fitted: FittedErrorModel, error: Tensor, outside: Tensor) -> Predicted:
    steps = range(1, error.shape[-1] + 1)
    told = torch.stack([fitted.model.prediction_variance(k) for k in steps])  # type: ignore[operator]
    return Predicted(error, told[:, 0].expand_as(error), (fitted,), int((outside > 0).sum()))
