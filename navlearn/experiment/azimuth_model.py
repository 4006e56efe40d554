"""The papers' models of the residual azimuth error: fitted to a window, run through an outage."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.fos import FosModel
from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.pci_fit import FittedPci, fit_pci
from navlearn.errors import ConfigError
from navlearn.experiment.feed_forward import FeedForward
from navlearn.fusion.filter_model import FilterModel
from navlearn.learning.azimuth_windows import (
    AzimuthRows,
    azimuth_rows,
    azimuth_target,
    error_unit,
    residual_azimuth,
)
from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.azimuth_spec import AzimuthSpec


@dataclass(frozen=True, kw_only=True)
class AzimuthModel:
    """A model fitted to the window before an outage, and what it says of the outage.

    Attributes:
        fitted: The model with its record.
        rows: Rows of the window and of the outage.
        inputs: Their regressors, shape (N, m).
        origin: Row at which GNSS ended.
        residual: ΔA through the outage, from row ``origin`` on, rad, shape (N − origin,).
        training_error: RMS of what is left of the target in the window, rad or rad per step.
        explained: Share of the target's mean square that the model takes there.
    """

    fitted: FittedErrorModel
    rows: AzimuthRows
    inputs: Tensor
    origin: int
    residual: Tensor
    training_error: float
    explained: float

    @property
    def size(self) -> int:
        """Terms or cascades accepted."""
        if isinstance(self.fitted, FittedPci):
            return self.fitted.cascades
        model = self.fitted.model
        return len(model.terms) if isinstance(model, FosModel) else 0

    @property
    def outside(self) -> int:
        """Inputs through the outage that were not met in training."""
        count: Tensor = self.fitted.model.count_clamped(self.inputs[self.origin :])  # type: ignore[operator]
        return int(count.sum())

    def at(self, time: Tensor) -> Tensor:
        """Return ΔA at some times of the outage, on straight lines between the rows.

        Args:
            time: Times on the clock of the rows, s, shape (L,).

        Returns:
            ΔA, rad, shape (L,).
        """
        knots = self.rows.time[self.origin :].numpy()
        return torch.from_numpy(np.interp(time.numpy(), knots, self.residual.numpy()))


def input_columns(spec: AzimuthSpec, model: FilterModel) -> list[int]:
    """Return where the inputs of a spec stand in a filter's error state.

    Args:
        spec: The spec; no inputs stand for all.
        model: The filter.

    Raises:
        ConfigError: The filter has no such error.
    """
    names = model.layout.names
    for name in spec.inputs:
        if name not in names:
            raise ConfigError(
                f"{spec.name}: the filter has no error {name!r}{nearest_hint(name, names)}; "
                f"known: {', '.join(names)}"
            )
    return [names.index(name) for name in spec.inputs or names]


def fit_azimuth(
    spec: AzimuthSpec,
    model: FilterModel,
    run: FeedForward,
    *,
    step: float,
    log_name: str = "",
    begin: float = 0.0,
) -> AzimuthModel:
    """Fit a model to the window of a feed-forward run, and run it through the outage after it.

    Args:
        spec: What is learned.
        model: The filter.
        run: Its run over window and outage.
        step: Time between rows, s.
        log_name: For the record.
        begin: When the run's first interval begins, s from the start of the log, for the record.

    Raises:
        FitError: The window holds nothing to learn from.
        ConfigError: The filter has no such error.
    """
    rows = azimuth_rows(
        model, run.history, run.samples, run.fixes, run.timing,
        step=step, slowest=spec.course_speed, origin=run.gone - 1,
    )  # fmt: skip
    columns = input_columns(spec, model)
    names = tuple(model.layout.names[k] for k in columns)
    source = TrainingSource(
        logs=(log_name,) if log_name else (),
        acts_on="azimuth" if spec.target == "angle" else "azimuth_rate",
        inputs=names,
        outputs=("azimuth",),
        time_step=step,
        input_units=tuple(error_unit(name) for name in names),
    )
    origin = int((rows.time - run.samples.dt[: run.gone].sum()).abs().argmin())
    learned = fit_rows(spec, rows, columns, origin=origin, source=source)
    span = (begin + float(rows.time[0]), begin + float(rows.time[origin]))
    record = replace(learned.fitted.record, time_span=span)
    return replace(learned, fitted=replace(learned.fitted, record=record))


def fit_rows(
    spec: AzimuthSpec,
    rows: AzimuthRows,
    columns: list[int],
    *,
    origin: int,
    source: TrainingSource | None = None,
) -> AzimuthModel:
    """Fit a model to rows with GNSS, and run it over those without.

    Args:
        spec: What is learned.
        rows: All rows.
        columns: Which predicted errors are inputs.
        origin: The last row with GNSS.
        source: For the record, and how far rows are apart.

    Raises:
        FitError: The rows hold nothing to learn from.
    """
    inputs, step = rows.inputs[:, columns], (source or TrainingSource()).time_step
    window = AzimuthRows(*(channel[: origin + 1] for channel in rows))
    target, weight = azimuth_target(window, spec.target, step)
    u, y = inputs[: origin + 1], target.unsqueeze(-1)
    if spec.structure == "fos":
        fitted = fit_fos(u, y, weight, spec.fos_options(), source)
    else:
        fitted = fit_pci(u, y, spec.pci_options(inputs=len(columns)), weight, source=source)
    with torch.no_grad():
        output: Tensor = fitted.model(inputs)[..., 0]
    used = _whole(weight, fitted.model) * weight
    left = ((output[: origin + 1] - target).square() * used).sum() / used.sum()
    whole = (target.square() * used).sum() / used.sum()
    return AzimuthModel(
        fitted=fitted,
        rows=rows,
        inputs=inputs,
        origin=origin,
        residual=residual_azimuth(output[origin:], rows.time[origin:], spec.target, step),
        training_error=float(left.sqrt()),
        explained=1.0 - float(left / whole) if float(whole) > 0.0 else 0.0,
    )


def _whole(weight: Tensor, model: nn.Module) -> Tensor:
    """Return 1.0 for rows whose past lies in the window, as the fit asks for it, shape (N,)."""
    past = int(model.memory)  # type: ignore[arg-type]
    if isinstance(model, FosModel):
        return (torch.arange(len(weight)) >= past).to(weight)
    whole = (weight > 0.0).unfold(-1, past, 1).all(-1)
    return torch.nn.functional.pad(whole, (past - 1, 0)).to(weight)
