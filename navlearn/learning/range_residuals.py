"""Series of range residuals per satellite on a grid of time, with what may explain them.

A target exists where enough satellites were tracked for the solution to be one; an input exists
where the satellite was received, through a partial outage too. Rows are equally spaced, so that
lags mean time; gaps stay gaps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.learning.range_record import RangeRecord

CHANNELS: Final[dict[str, tuple[str, str]]] = {
    "elevation": ("rad", "elevation of the satellite"),
    "cn0": ("dB-Hz", "carrier-to-noise density"),
    "predicted_range": ("m", "pseudorange as the filter predicts it"),
    "spread": ("m", "deviation that the filter gives its innovation"),
    "innovation": ("m", "innovation of the filter that nothing corrects"),
    "speed": ("m/s", "speed over ground"),
    "along_sight": ("m/s", "speed toward the satellite"),
    "tracked_for": ("s", "time since the satellite was last lost"),
}
"""Inputs of range-error models: unit and meaning."""

HELD: Final[dict[str, tuple[str, str]]] = {
    "recent": ("m", "mean residual before GNSS went, held"),
    "delay": ("s", "time since GNSS went"),
}
"""Inputs that only exist in an outage; a model with one of them learns from emulated ones."""

LOST_AFTER: Final = 2.5
"""A satellite not received for longer than so many intervals was lost."""


@dataclass(frozen=True, kw_only=True)
class ResidualOptions:
    """What is put on the grid.

    Attributes:
        inputs: Names of :data:`CHANNELS`.
        min_satellites: Fewest satellites tracked for a target to exist, at least 4.
        step: Length of a row, s; longer where ranges come less often.
    """

    inputs: tuple[str, ...] = ("elevation", "cn0")
    min_satellites: int = 5
    step: float = 1.0

    def __post_init__(self) -> None:
        for name in self.inputs:
            if name not in CHANNELS:
                raise ConfigError(
                    f"range residuals: unknown input {name!r}; known: {', '.join(CHANNELS)}"
                )
        if self.min_satellites < 4:
            raise ConfigError(
                f"range residuals: min_satellites is {self.min_satellites}; with fewer than 4 "
                "there is no solution to compare with"
            )
        if not self.step > 0.0:
            raise ConfigError(f"range residuals: step is {self.step} s; it must be positive")


class ResidualSeries(NamedTuple):
    """Residuals of S satellites in T rows, the outage's first row among them.

    Attributes:
        target: What is learned, m, NaN where there is none, shape (T, S).
        inputs: Inputs, NaN where the satellite was not received, shape (T, S, m).
        row: Row of each reception of the record, int64, shape (R,).
        origin: First row of the outage.
        step: Length of a row, s.
    """

    target: Tensor
    inputs: Tensor
    row: Tensor
    origin: int
    step: float


def residual_series(record: RangeRecord, start: float, options: ResidualOptions) -> ResidualSeries:
    """Return a record on a grid whose rows do not reach across an outage's start.

    Several receptions in one row are averaged.

    Args:
        record: What the filter made of receptions before the outage's start and after it.
        start: The outage's start, s; nothing received from there on is a target.
        options: What is wanted.
    """
    row, origin, step = _rows(record.t, start, options.step)
    known = record.t < start
    full = record.taken.sum(-1) >= options.min_satellites
    learnt = (known & full).unsqueeze(-1) & record.taken
    target = torch.where(learnt, record.residual, torch.nan)
    rows = max(int(row.max()) + 1 if len(row) else 0, origin)
    channels = [_FOUND[name](record) for name in options.inputs]
    inputs = (
        torch.stack(channels, -1)
        if channels
        else record.residual.new_zeros((*record.residual.shape, 0))
    )
    return ResidualSeries(
        target=mean_by_row(target, row, rows),
        inputs=mean_by_row(inputs, row, rows),
        row=row,
        origin=origin,
        step=step,
    )


def _rows(t: Tensor, start: float, step: float) -> tuple[Tensor, int, float]:
    """Return the row of each time, the first row from a start on, and the length of a row."""
    if len(t) == 0:
        return torch.zeros(0, dtype=torch.int64), 0, step
    if len(t) > 1:
        step = max(step, float(torch.diff(t).median()))
    later = t >= start
    # Rows are centred on receptions, so that a jitter of their times leaves one in each.
    anchor = float(t[later][0]) if bool(later.any()) else start
    cell = torch.floor((t - anchor) / step + 0.5).to(torch.int64)
    cell = torch.where(later, cell.clamp(min=0), cell.clamp(max=-1))
    first = min(int(cell.min()), 0)
    return cell - first, -first, step


def mean_by_row(values: Tensor, row: Tensor, rows: int) -> Tensor:
    """Return the mean of the finite values in each row; NaN where there is none.

    Args:
        values: Shape (R, ...).
        row: Row of each, int64, shape (R,).
        rows: Number of rows T.

    Returns:
        Shape (T, ...).
    """
    fine = torch.isfinite(values)
    total = values.new_zeros((rows, *values.shape[1:]))
    count = total.clone()
    total.index_add_(0, row, torch.where(fine, values, 0.0))
    count.index_add_(0, row, fine.to(values))
    return torch.where(count > 0.0, total / count.clamp(min=1.0), torch.nan)


def tracked_for(t: Tensor, received: Tensor) -> Tensor:
    """Return for how long each satellite has been received without interruption.

    Args:
        t: Times of the receptions, s, shape (R,).
        received: Whether each satellite was, bool, shape (R, S).

    Returns:
        s, NaN where it was not received, shape (R, S).
    """
    if len(t) == 0:
        return t.new_zeros(received.shape)
    interval = float(torch.diff(t).median()) if len(t) > 1 else 0.0
    age = []
    since = t.new_full((received.shape[-1],), torch.nan)
    last = t.new_full((received.shape[-1],), -torch.inf)
    for time, there in zip(t.unbind(0), received.unbind(0), strict=True):
        lost = time - last > LOST_AFTER * interval
        since = torch.where(there & lost, time, since)
        last = torch.where(there, time, last)
        age.append(torch.where(there, time - since, torch.nan))
    return torch.stack(age)


_FOUND: Final[dict[str, Callable[[RangeRecord], Tensor]]] = {
    "elevation": lambda record: record.elevation,
    "cn0": lambda record: record.cn0,
    "predicted_range": lambda record: record.predicted,
    "spread": lambda record: record.spread,
    "innovation": lambda record: record.innovation,
    "speed": lambda record: record.speed,
    "along_sight": lambda record: record.along_sight,
    "tracked_for": lambda record: tracked_for(record.t, torch.isfinite(record.residual)),
}
