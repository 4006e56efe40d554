"""How well drives told each noise entry: standard errors that survive a wrong model.

The curvature of the log-likelihood says how sure it is of itself; how its slope differs from
window to window says how sure it may be. Both together make the sandwich of [White1982], which
holds where the density is not that of the data. Entries that only show together (a floor and an
inflation, where a receiver always tells the same deviation) are not told one by one; the deviation
of a fix that they make up is.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.learning.fix_deviations import fix_deviations
from navlearn.learning.noise_objective import NoiseObjective
from navlearn.learning.noise_parameters import unit_of

STEP = 0.03
"""Step of the differences that give curvature and slopes, in the logarithm."""

TOLD = 0.5
"""An entry is told by the drives where its standard error is below this share of the prior's."""


@dataclass(frozen=True, kw_only=True)
class ParameterFigure:
    """One noise entry, or a deviation that several make up, before and after.

    Attributes:
        name: Its name.
        unit: Its unit.
        before: Value at the start.
        after: Value found.
        error: Standard error of its logarithm: a relative error where it is small.
        curvature: Second derivative of minus the log-likelihood by its logarithm, nats; NaN for
            what several entries make up.
        told: Whether the drives told it; else the prior holds it where it began.
    """

    name: str
    unit: str
    before: float
    after: float
    error: float
    curvature: float
    told: bool

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of 95 % of the value."""
        factor = math.exp(1.96 * self.error)
        return self.after / factor, self.after * factor


class NoiseFigures(NamedTuple):
    """What drives tell of a filter's noise.

    Attributes:
        entries: One per free entry.
        fixes: Deviations of typical fixes, which several entries make up.
    """

    entries: tuple[ParameterFigure, ...]
    fixes: tuple[ParameterFigure, ...]


def noise_figures(objective: NoiseObjective, logs: Tensor) -> NoiseFigures:
    """Return what drives tell of each free entry.

    Args:
        objective: The drives, with verdicts taken.
        logs: Logarithms found, shape (P,).

    Raises:
        FilterDivergedError: A filter is lost next to the solution.
    """
    curvature, slopes = _curvature_and_slopes(objective, logs)
    precision = objective.precision
    covariance = _sandwich(curvature, slopes, precision)
    start, prior = objective.parameters.start, precision**-0.5
    # few windows tell slopes badly; nothing is known worse than it was before
    errors = covariance.diagonal().sqrt().clamp(max=prior)
    entries = tuple(
        ParameterFigure(
            name=name,
            unit=unit_of(name),
            before=float(torch.exp(start[i])),
            after=float(torch.exp(logs[i])),
            error=float(errors[i]),
            curvature=float(curvature[i, i]),
            told=bool(errors[i] < TOLD * prior),
        )
        for i, name in enumerate(objective.parameters.names)
    )
    return NoiseFigures(entries, _of_fixes(objective, logs, covariance))


def _sandwich(curvature: Tensor, slopes: Tensor, precision: float) -> Tensor:
    """Return the covariance of the logarithms found, shape (P, P)."""
    eye = torch.eye(curvature.shape[0], dtype=curvature.dtype)
    values, axes = torch.linalg.eigh(curvature + precision * eye)
    # at a boundary the surface may bend the wrong way; the prior's own bend is the least there is
    inverse = axes @ torch.diag(1.0 / values.clamp(min=precision)) @ axes.T
    spread = slopes - slopes.mean(0)
    covariance: Tensor = inverse @ (spread.T @ spread + precision * eye) @ inverse
    return covariance


def _of_fixes(
    objective: NoiseObjective, logs: Tensor, covariance: Tensor
) -> tuple[ParameterFigure, ...]:
    leaf = logs.detach().clone().requires_grad_(True)
    before = fix_deviations(objective.drives, objective.parameters, objective.parameters.start)
    found = []
    for name, unit, after in fix_deviations(objective.drives, objective.parameters, leaf):
        (slope,) = torch.autograd.grad(torch.log(after), leaf, retain_graph=True, allow_unused=True)
        slope = torch.zeros_like(logs) if slope is None else slope
        error = float((slope @ covariance @ slope).clamp(min=0.0).sqrt())
        old = next(float(value) for other, _, value in before if other == name)
        found.append(
            ParameterFigure(
                name=name,
                unit=unit,
                before=old,
                after=float(after.detach()),
                error=error,
                curvature=math.nan,
                told=error < TOLD * objective.precision**-0.5,
            )
        )
    return tuple(found)


def _curvature_and_slopes(objective: NoiseObjective, logs: Tensor) -> tuple[Tensor, Tensor]:
    """Return the Hessian of minus the log-likelihood (P, P), and windows' slopes (W, P)."""
    rows, columns = [], []
    here, level = objective.with_windows(logs)
    for i in range(logs.shape[0]):
        step = torch.zeros_like(logs)
        step[i] = STEP
        there, windows = objective.with_windows(logs + step)
        rows.append((there.gradient - here.gradient) / STEP)
        columns.append((windows - level) / STEP)
    hessian = torch.stack(rows)
    prior = objective.precision * torch.eye(len(rows), dtype=logs.dtype)
    return 0.5 * (hessian + hessian.T) - prior, torch.stack(columns, -1)
