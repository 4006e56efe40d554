"""An ANARX network per axis of the position error, and its run on its own output.

[Jaradat2017] §III: three networks in parallel, each trained by itself. Their target is
reference − INS, so that a prediction is added to the INS, (16).
"""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.anarx_options import AnarxOptions
from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.errors import ConfigError
from navlearn.learning.fit import fit_anarx
from navlearn.learning.options import TrainingOptions
from navlearn.learning.position_series import SERIES_INPUTS, PositionSeries, series_inputs
from navlearn.learning.position_windows import (
    ROW_SPLITS,
    AxisWindows,
    RowSplit,
    free_run_windows,
    open_loop_windows,
    part_of,
)

AXES: Final = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class PositionFitOptions:
    """How the networks of a position record are trained.

    Attributes:
        network: Shape of each.
        training: Its training; ``loop`` tells whether rows or windows are learned.
        inputs: Names of the regressors.
        split: ``random`` rows (windows in closed loop) as in the paper, or by ``time``.
        gap: Rows left unused between the parts, for ``time``.
        length: Rows of a free run, for closed loop.
        stride: Least number of rows between two of them.
        fixes_only: Scores rows at fixes alone.
    """

    network: AnarxOptions
    training: TrainingOptions
    inputs: tuple[str, ...] = tuple(SERIES_INPUTS)
    split: str = "random"
    gap: int = 0
    length: int = 500
    stride: int = 250
    fixes_only: bool = False

    def __post_init__(self) -> None:
        if self.split not in ROW_SPLITS:
            raise ConfigError(f"split {self.split!r} is not one of {', '.join(ROW_SPLITS)}")
        if self.network.inputs != len(self.inputs) or self.network.outputs != 1:
            raise ConfigError(
                f"position networks: {self.network.inputs} inputs and {self.network.outputs} "
                f"outputs; expected {len(self.inputs)} inputs and one output"
            )


class AxisFit(NamedTuple):
    """The network of one axis, and what it makes of what it learned from.

    Attributes:
        fitted: The network.
        windows: Its rows, with their parts.
        predicted: Prediction of every row, in the loop of the training, m, shape (N, T).
        before: The target one row earlier, m, shape (N, T): what "nothing changes" predicts.
    """

    fitted: FittedErrorModel
    windows: AxisWindows
    predicted: Tensor
    before: Tensor


def fit_position(
    series: PositionSeries, options: PositionFitOptions, source: TrainingSource | None = None
) -> tuple[AxisFit, ...]:
    """Train a network per axis.

    Args:
        series: The record; rows after its last fix are not read.
        options: How.
        source: What is known of the data, for the record.

    Raises:
        FitError: The record is too short, or cannot be learned from.
    """
    return tuple(_fit_axis(series, axis, options, source) for axis in range(series.ins.shape[-1]))


def _fit_axis(
    series: PositionSeries, axis: int, options: PositionFitOptions, source: TrainingSource | None
) -> AxisFit:
    training = options.training
    split = RowSplit(options.split, options.gap, training.seed)
    if training.loop == "open":
        made = open_loop_windows(series, axis, options.inputs, split, fixes_only=options.fixes_only)
    else:
        made = free_run_windows(
            series,
            axis,
            options.inputs,
            split,
            length=options.length,
            stride=options.stride,
            warmup=options.network.lags - 1,
            fixes_only=options.fixes_only,
        )
    fitted = fit_anarx(
        part_of(made, 0),
        part_of(made, 1),
        options.network,
        training,
        source=source,
        progress=False,
    )
    return AxisFit(fitted, made, *_predictions(fitted, made, training.loop))


@torch.no_grad()
def _predictions(fitted: FittedErrorModel, made: AxisWindows, loop: str) -> tuple[Tensor, Tensor]:
    """Return predictions and the targets one row earlier, shape (N, T) each."""
    model: Any = fitted.model
    w = made.windows
    start = torch.zeros_like(w.y[:, 0]) if w.y_start is None else w.y_start
    before = torch.cat((start.unsqueeze(1), w.y[:, :-1]), 1).squeeze(-1)
    if loop == "open":
        return model.open_loop(w.u, w.y, start).squeeze(-1), before
    state = model.initial_state(w.u[:, 0], start)
    if w.warmup:
        state = model.warm_state(w.u[:, : w.warmup], w.y[:, : w.warmup], start)
    free, _ = model.run(w.u[:, w.warmup :], state)
    return torch.cat((w.y[:, : w.warmup], free), 1).squeeze(-1), before


@torch.no_grad()
def run_on_own_output(
    fits: tuple[AxisFit, ...],
    series: PositionSeries,
    inputs: tuple[str, ...],
    *,
    after: int = 0,
) -> Tensor:
    """Run the networks in closed loop (parallel): no target is read after a row.

    Args:
        fits: A network per axis.
        series: The record, as long as it is to be run; fixes enter by ``held`` alone.
        inputs: Names of the regressors.
        after: Last row whose target feeds the network.

    Returns:
        Predicted GNSS − INS of the rows after ``after``, m, shape (T − 1 − after, 3).
    """
    axes = []
    for axis, fit in enumerate(fits):
        model: Any = fit.fitted.model
        u = series_inputs(series, axis, inputs)[:-1]
        y = series.target[:, axis : axis + 1]
        if after == 0:
            state = model.initial_state(u[0], y[0])
        else:
            first = max(0, after - model.memory)
            state = model.warm_state(u[first:after], y[first + 1 : after + 1], y[first])
        axes.append(model.run(u[after:], state)[0].squeeze(-1))
    return torch.stack(axes, -1)
