"""How well drives told each noise entry: standard errors that survive a wrong model.

The curvature of the log-likelihood says how sure it is of itself; how its slope differs from
window to window says how sure it may be. Both together make the sandwich of [White1982], which
holds where the density is not that of the data.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from navlearn.learning.noise_objective import NoiseObjective
from navlearn.learning.noise_parameters import unit_of

STEP = 0.03
"""Step of the differences that give curvature and slopes, in the logarithm."""

TOLD = 0.5
"""An entry is told by the drives where its standard error is below this share of the prior's."""


@dataclass(frozen=True, kw_only=True)
class ParameterFigure:
    """One noise entry before and after.

    Attributes:
        name: Its name.
        unit: Its unit.
        before: Value at the start.
        after: Value found.
        curvature: Second derivative of minus the log-likelihood by its logarithm, nats.
        error: Standard error of its logarithm: a relative error where it is small.
        told: Whether the drives told it; else the prior holds it where it began.
    """

    name: str
    unit: str
    before: float
    after: float
    curvature: float
    error: float
    told: bool

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of 95 % of the value."""
        factor = float(torch.exp(torch.tensor(1.96 * self.error)))
        return self.after / factor, self.after * factor


def parameter_figures(objective: NoiseObjective, logs: Tensor) -> tuple[ParameterFigure, ...]:
    """Return what drives tell of each free entry.

    Args:
        objective: The drives, with verdicts taken.
        logs: Logarithms found, shape (P,).

    Raises:
        FilterDivergedError: A filter is lost next to the solution.
    """
    curvature, slopes = _curvature_and_slopes(objective, logs)
    precision = objective.precision
    eye = torch.eye(logs.shape[0], dtype=logs.dtype)
    values, axes = torch.linalg.eigh(curvature + precision * eye)
    # at a boundary the surface may bend the wrong way; the prior's own bend is the least there is
    inverse = axes @ torch.diag(1.0 / values.clamp(min=precision)) @ axes.T
    spread = slopes - slopes.mean(0)
    covariance = inverse @ (spread.T @ spread + precision * eye) @ inverse
    prior = precision**-0.5
    # few windows tell slopes badly; nothing is known worse than it was before
    errors = covariance.diagonal().sqrt().clamp(max=prior)
    names, before = objective.parameters.names, objective.parameters.start
    return tuple(
        ParameterFigure(
            name=name,
            unit=unit_of(name),
            before=float(torch.exp(before[i])),
            after=float(torch.exp(logs[i])),
            curvature=float(curvature[i, i]),
            error=float(errors[i]),
            told=bool(errors[i] < TOLD * prior),
        )
        for i, name in enumerate(names)
    )


def _curvature_and_slopes(objective: NoiseObjective, logs: Tensor) -> tuple[Tensor, Tensor]:
    """Return the Hessian of minus the log-likelihood (P, P), and windows' slopes (W, P)."""
    rows, columns = [], []
    prior = objective.precision
    for i in range(logs.shape[0]):
        step = torch.zeros_like(logs)
        step[i] = STEP
        up, down = objective(logs + step), objective(logs - step)
        rows.append((up.gradient - down.gradient) / (2.0 * STEP))
        high, low = objective.windows(logs + step), objective.windows(logs - step)
        columns.append((high - low) / (2.0 * STEP))
    hessian = torch.stack(rows)
    hessian = 0.5 * (hessian + hessian.T) - prior * torch.eye(len(rows), dtype=logs.dtype)
    return hessian, torch.stack(columns, -1)
