"""Diagnostics of position-error networks, made of what their fits leave."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel
from navlearn.learning.ins_position_windows import INS_OUTPUTS
from navlearn.learning.position_fit import AXES, AxisFit
from navlearn.learning.position_series import PositionSeries
from navlearn.learning.position_windows import PARTS
from navlearn.learning.windows import Windows
from navlearn.outages.fit_diagnostics import AxisDiagnostics, FitDiagnostics, FusedPath
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec

Diagnose = Callable[[str, FitDiagnostics], None]
"""Called with the name of a model and the diagnostics of each of its fits."""


def paper_diagnostics(
    spec: InsAnarxSpec,
    fits: tuple[AxisFit, ...],
    series: PositionSeries,
    fused: Tensor,
) -> FitDiagnostics:
    """Return the diagnostics of networks per Earth-fixed axis.

    Args:
        spec: The model.
        fits: A network per axis.
        series: What they learned from.
        fused: Their path in closed loop over all rows but the first, m, shape (T − 1, 3).
    """
    axes = []
    for name, fit in zip(AXES, fits, strict=True):
        windows = fit.windows
        axes.append(
            AxisDiagnostics(
                axis=name,
                target=windows.windows.y.reshape(-1).numpy(),
                predicted=fit.predicted.reshape(-1).numpy(),
                unchanged=fit.before.reshape(-1).numpy(),
                part=_words(windows.part),
                at_fix=series.at_fix[windows.row].reshape(-1).numpy(),
            )
        )
    origin = series.ins[0]
    at_fix = series.at_fix
    path = FusedPath(
        t=series.t[1:].numpy(),
        ins=(series.ins[1:] - origin).numpy(),
        fused=(fused - origin).numpy(),
        fix_t=series.t[at_fix].numpy(),
        fix=(series.held[at_fix] - origin).numpy(),
        origin=origin.numpy(),
    )
    return FitDiagnostics(
        method=spec.name,
        loop=spec.training.removesuffix("_loop"),
        split=spec.split,
        axes=tuple(axes),
        path=path,
    )


@torch.no_grad()
def sound_diagnostics(
    spec: InsAnarxSpec,
    fitted: FittedErrorModel,
    windows: Windows,
    parts: tuple[Tensor, Tensor, Tensor],
) -> FitDiagnostics:
    """Return the diagnostics of a network on increments of the coast's error.

    Args:
        spec: The model.
        fitted: It, as it was on trial.
        windows: All emulated outages.
        parts: Which of them train, validate and judge.
    """
    model: Any = fitted.model
    if spec.training == "open_loop":
        predicted = model.open_loop(windows.u, windows.y)
    else:
        predicted = model(windows.u)
    before = torch.cat((torch.zeros_like(windows.y[:, :1]), windows.y[:, :-1]), 1)
    part = torch.full(windows.y.shape[:2], -1)
    for k, index in enumerate(parts):
        part[index] = k
    axes = tuple(
        AxisDiagnostics(
            axis=name,
            target=windows.y[..., k].reshape(-1).numpy(),
            predicted=predicted[..., k].reshape(-1).numpy(),
            unchanged=before[..., k].reshape(-1).numpy(),
            part=_words(part),
        )
        for k, name in enumerate(INS_OUTPUTS)
    )
    return FitDiagnostics(
        method=spec.name, loop=spec.training.removesuffix("_loop"), split=spec.split, axes=axes
    )


def _words(part: Tensor) -> NDArray[np.str_]:
    """Return the names of parts, empty for none, shape (R,)."""
    words: NDArray[np.str_] = np.array((*PARTS, ""))[part.reshape(-1).numpy()]
    return words
