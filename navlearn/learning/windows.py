"""Windows of regressors and targets, and how they are split into training and validation.

Row k of a window holds the inputs of the interval that ends when output k is valid. Neighbours
in time are alike, so a split is made by time, with a gap; the random split of [Jaradat2017]
leaks between neighbours and exists under its own name only.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError, FitError, ShapeError

SPLITS = ("time", "random_jaradat2017")


class Windows(NamedTuple):
    """N windows of T rows, m inputs and p outputs; float64.

    Attributes:
        u: Inputs, shape (N, T, m).
        y: Targets, shape (N, T, p).
        weight: Weight of each row, not negative, shape (N, T); zero marks padding.
        start_time: Start of each window, s from the start of the log, shape (N,).
        y_start: Output before the first row, shape (N, p); None stands for zero.
        warmup: Leading rows whose measured output is fed back before the model runs freely.
    """

    u: Tensor
    y: Tensor
    weight: Tensor
    start_time: Tensor
    y_start: Tensor | None = None
    warmup: int = 0


def check_windows(windows: Windows, name: str = "windows") -> Windows:
    """Return the windows as float64, or raise an error that says what is wrong with them.

    Args:
        windows: What to check.
        name: How the error message calls them.

    Raises:
        ShapeError: The shapes do not belong together.
        FitError: A value that counts is not finite, or nothing counts.
    """
    u, y, weight, start_time, y_start, warmup = windows
    if u.ndim != 3 or y.ndim != 3 or u.shape[:2] != y.shape[:2]:
        raise ShapeError(
            f"{name}: u has shape {tuple(u.shape)} and y {tuple(y.shape)}; "
            "expected (N, T, m) and (N, T, p)"
        )
    if weight.shape != u.shape[:2] or start_time.shape != u.shape[:1]:
        raise ShapeError(
            f"{name}: weight has shape {tuple(weight.shape)} and start_time "
            f"{tuple(start_time.shape)}; expected {tuple(u.shape[:2])} and {tuple(u.shape[:1])}"
        )
    if y_start is None:
        y_start = torch.zeros_like(y[:, 0])
    if y_start.shape != (y.shape[0], y.shape[2]):
        raise ShapeError(
            f"{name}: y_start has shape {tuple(y_start.shape)}; expected {(y.shape[0], y.shape[2])}"
        )
    if not 0 <= warmup < max(u.shape[1], 1):
        raise ShapeError(f"{name}: warmup is {warmup}; a window has {u.shape[1]} rows")
    for label, values in (("u", u), ("y", y), ("weight", weight), ("y_start", y_start)):
        _check_finite(values, name, label)
    if bool((weight < 0).any()):
        raise FitError(f"{name}: a weight is negative ({float(weight.min())}); use zero to drop")
    if not bool((weight[:, warmup:] > 0).any()):
        raise FitError(f"{name}: no row counts (N = {u.shape[0]}, T = {u.shape[1]})")
    return Windows(
        u.double(), y.double(), weight.double(), start_time.double(), y_start.double(), warmup
    )


def _check_finite(values: Tensor, name: str, label: str) -> None:
    bad = torch.logical_not(torch.isfinite(values)).nonzero()
    if bad.shape[0]:
        raise FitError(
            f"{name}: {label} holds {bad.shape[0]} values that are not finite, the first at "
            f"index {tuple(bad[0].tolist())}; drop the window, or fill the row and give it "
            "weight zero"
        )


def windows_from_series(
    u: Tensor,
    y: Tensor,
    *,
    length: int,
    stride: int,
    warmup: int = 0,
    start_time: float = 0.0,
    time_step: float = 1.0,
) -> Windows:
    """Cut a record into windows; the first row only gives the output before a window.

    Args:
        u: Inputs, shape (T, m).
        y: Outputs, shape (T, p).
        length: Rows per window that count.
        stride: Rows between the starts of neighbours.
        warmup: Rows added in front of each window, fed with measured outputs and not scored.
        start_time: Time of the first row, s.
        time_step: Seconds between rows.

    Raises:
        ShapeError: The record is shorter than one window, or the shapes differ.
    """
    rows = length + warmup
    if u.ndim != 2 or y.ndim != 2 or u.shape[0] != y.shape[0]:
        raise ShapeError(f"u {tuple(u.shape)} and y {tuple(y.shape)} must be (T, m) and (T, p)")
    if length < 1 or stride < 1 or u.shape[0] < rows + 1:
        raise ShapeError(
            f"a record of {u.shape[0]} rows holds no window of {rows} rows and one before it "
            f"(length {length}, warmup {warmup}, stride {stride}, both at least 1)"
        )
    starts = torch.arange(1, u.shape[0] - rows + 1, stride)
    index = starts.unsqueeze(1) + torch.arange(rows)
    weight = torch.ones(index.shape, dtype=torch.float64)
    weight[:, :warmup] = 0.0
    times = start_time + time_step * starts.double()
    return Windows(u[index], y[index], weight, times, y[starts - 1], warmup)


def select_windows(windows: Windows, index: Tensor) -> Windows:
    """Return the windows at an index or mask, shape (N',) or bool (N,)."""
    y_start = windows.y_start[index] if windows.y_start is not None else None
    return Windows(
        windows.u[index],
        windows.y[index],
        windows.weight[index],
        windows.start_time[index],
        y_start,
        windows.warmup,
    )


def split_windows(
    windows: Windows,
    *,
    duration: float,
    valid_fraction: float = 0.25,
    gap: float = 0.0,
    split: str = "time",
    seed: int = 0,
) -> tuple[Windows, Windows]:
    """Split windows into training and validation parts.

    Args:
        windows: All windows.
        duration: Length of a window, s.
        valid_fraction: Share of the windows that validates: the last in time.
        gap: Least time between the end of training and the start of validation, s.
        split: ``time``, or ``random_jaradat2017``: the paper's random split, which leaks between
            neighbours.
        seed: Seed of the random split.

    Raises:
        ConfigError: An option is unknown or out of range.
        FitError: A part would be empty.
    """
    if split not in SPLITS:
        raise ConfigError(f"split {split!r} is not one of {', '.join(SPLITS)}")
    if not 0.0 < valid_fraction < 1.0:
        raise ConfigError(f"valid_fraction is {valid_fraction}; it must lie between 0 and 1")
    count = windows.u.shape[0]
    held_back = max(1, round(valid_fraction * count))
    if split == "random_jaradat2017":
        generator = torch.Generator().manual_seed(seed)
        order = torch.randperm(count, generator=generator)
        train, valid = order[held_back:], order[:held_back]
    else:
        order = torch.argsort(windows.start_time, stable=True)
        valid = order[count - held_back :]
        latest = windows.start_time[valid].min() - gap - duration if held_back else 0.0
        train = order[: count - held_back]
        train = train[windows.start_time[train] <= latest + 1e-9]
    if train.numel() == 0:
        raise FitError(
            f"{count} windows of {duration} s leave none for training beside {held_back} for "
            f"validation and a gap of {gap} s; give more windows or a smaller gap"
        )
    return select_windows(windows, train), select_windows(windows, valid)
