"""Rows and windows of a position record, and which of them train, validate and test.

In open loop (series-parallel) the record is one window and its rows are divided; in closed loop
(parallel) windows are divided, and in every second of them fixes are withheld, as an outage
would. The random split is [Jaradat2017]'s: neighbours are alike, so what it calls a test has
been seen in training. The split by time leaves a gap.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError, FitError
from navlearn.learning.position_series import PositionSeries, series_inputs, without_fixes_after
from navlearn.learning.windows import Windows, select_windows

PARTS: Final = ("training", "validation", "test")
SHARES: Final = (0.70, 0.15)
"""Training and validation; the test has the rest. The paper prints no shares: these are usual."""

ROW_SPLITS: Final = ("random", "time")


class RowSplit(NamedTuple):
    """How stretches of rows are divided.

    Attributes:
        kind: ``random``, or ``time``: one part after the other.
        gap: Rows left unused between the parts, for ``time``.
        seed: Seed of the random split.
    """

    kind: str = "random"
    gap: int = 0
    seed: int = 0


class AxisWindows(NamedTuple):
    """Windows of one axis.

    Attributes:
        windows: N windows of T rows, one output.
        part: Index into :data:`PARTS` of each row, −1 for none, int64, shape (N, T).
        row: Row of the record, int64, shape (N, T).
    """

    windows: Windows
    part: Tensor
    row: Tensor


def assign_parts(start: Tensor, length: int, split: RowSplit) -> Tensor:
    """Return which part each stretch of rows belongs to, −1 for none, int64, shape (N,).

    Args:
        start: First row of each stretch, increasing, shape (N,).
        length: Rows of a stretch.
        split: How they are divided.

    Raises:
        ConfigError: The kind of split is another word.
        FitError: Training or validation gets nothing.
    """
    if split.kind not in ROW_SPLITS:
        raise ConfigError(f"split {split.kind!r} is not one of {', '.join(ROW_SPLITS)}")
    count = len(start)
    part = torch.full((count,), -1, dtype=torch.int64)
    if split.kind == "random":
        order = torch.randperm(count, generator=torch.Generator().manual_seed(split.seed))
        train, valid = round(SHARES[0] * count), round((SHARES[0] + SHARES[1]) * count)
        part[order[:train]], part[order[train:valid]], part[order[valid:]] = 0, 1, 2
    elif count:
        span = int(start[-1]) + length - int(start[0])
        first = int(start[0]) + SHARES[0] * span
        second = first + SHARES[1] * span
        end = start + length
        part[end <= first] = 0
        part[(start >= first + split.gap) & (end <= second)] = 1
        part[start >= second + split.gap] = 2
    if not bool((part == 0).any() and (part == 1).any()):
        raise FitError(
            f"{count} stretches of {length} rows leave {int((part == 0).sum())} to train and "
            f"{int((part == 1).sum())} to validate; learn from a longer record or shorter windows"
        )
    return part


def open_loop_windows(
    series: PositionSeries,
    axis: int,
    inputs: tuple[str, ...],
    split: RowSplit,
    *,
    fixes_only: bool = False,
) -> AxisWindows:
    """Return the record as one window whose rows are divided.

    Args:
        series: The record.
        axis: Index of the axis.
        inputs: Names of the regressors.
        split: How rows are divided.
        fixes_only: Scores rows at fixes alone; the others still feed the network.
    """
    known = int(series.known.sum())
    u = series_inputs(series, axis, inputs)[: known - 1]
    y = series.target[1:known, axis : axis + 1]
    scored = torch.arange(1, known)
    if fixes_only:
        scored = scored[series.at_fix[1:known]]
    part = torch.full((known,), -1, dtype=torch.int64)
    part[scored] = assign_parts(scored, 1, split)
    windows = Windows(
        u.unsqueeze(0),
        y.unsqueeze(0),
        (part[1:] >= 0).double().unsqueeze(0),
        series.t[:1],
        series.target[:1, axis : axis + 1],
    )
    return AxisWindows(windows, part[1:].unsqueeze(0), torch.arange(1, known).unsqueeze(0))


def free_run_windows(
    series: PositionSeries,
    axis: int,
    inputs: tuple[str, ...],
    split: RowSplit,
    *,
    length: int,
    stride: int,
    warmup: int,
    fixes_only: bool = False,
) -> AxisWindows:
    """Return windows that begin after a fix; in every second one no further fix comes.

    Args:
        series: The record.
        axis: Index of the axis.
        inputs: Names of the regressors.
        split: How windows are divided.
        length: Rows of the free run.
        stride: Least number of rows between the starts of neighbours.
        warmup: Rows before each whose measured outputs are fed.
        fixes_only: Scores rows at fixes alone.

    Raises:
        FitError: The record is too short.
    """
    known = int(series.known.sum())
    starts: list[int] = []
    for row in torch.nonzero(series.at_fix).squeeze(-1).tolist():
        fits = row > warmup and row + length < known
        if fits and (not starts or row - starts[-1] >= stride):
            starts.append(row)
    start = torch.tensor(starts, dtype=torch.int64)
    part = assign_parts(start, length, split)
    row = start.unsqueeze(1) + 1 - warmup + torch.arange(length + warmup)
    u = series_inputs(series, axis, inputs)[row - 1]
    for k in range(1, len(starts), 2):
        emulated = without_fixes_after(series, starts[k])
        u[k] = series_inputs(emulated, axis, inputs)[row[k] - 1]
    weight = torch.ones(row.shape, dtype=torch.float64)
    weight[:, :warmup] = 0.0
    if fixes_only:
        weight *= series.at_fix[row]
    windows = Windows(
        u,
        series.target[row, axis : axis + 1],
        weight,
        series.t[start],
        series.target[row[:, 0] - 1, axis : axis + 1],
        warmup,
    )
    rows_part = torch.where(weight > 0, part.unsqueeze(1), -1)
    return AxisWindows(windows, rows_part, row)


def part_of(windows: AxisWindows, part: int) -> Windows:
    """Return the windows that hold rows of one part, with no weight on any other row.

    Args:
        windows: Windows of an axis.
        part: Index into :data:`PARTS`.
    """
    mine = windows.windows
    weight = mine.weight * (windows.part == part)
    return select_windows(mine._replace(weight=weight), (weight > 0).any(1))
