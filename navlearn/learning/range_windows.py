"""Windows of a drive's past that a range-error model is fitted to, and what it runs on ahead."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.learning.range_error_options import RangeErrorOptions
from navlearn.learning.range_level import recent_mean
from navlearn.learning.range_residuals import ResidualSeries

EMULATED_EVERY_S = 5.0
"""Time between the starts of the emulated outages that a window is cut into, s."""


class RangeWindows(NamedTuple):
    """The pasts of n satellites before one outage, W rows, and H rows ahead, m inputs.

    Attributes:
        target: What is learned, m, NaN where there is none, shape (n, W).
        inputs: Inputs in the past, NaN where there is none, shape (n, W, m).
        ahead: Inputs through the outage, held through gaps, shape (n, H, m).
        step: Length of a row, s.
    """

    target: Tensor
    inputs: Tensor
    ahead: Tensor
    step: float


def past_windows(series: ResidualSeries, slots: Tensor, options: RangeErrorOptions) -> RangeWindows:
    """Return the window before an outage, for some satellites.

    Args:
        series: Residuals and inputs on the grid.
        slots: The satellites, int64, shape (n,).
        options: Tell the window's length.
    """
    first = max(0, series.origin - round(options.window_s / series.step))
    target = series.target[first : series.origin, slots].T
    inputs = series.inputs[first : series.origin, slots].transpose(0, 1)
    ahead = series.inputs[series.origin :, slots].transpose(0, 1)
    return RangeWindows(target, inputs, held_through_gaps(ahead, inputs), series.step)


def held_through_gaps(ahead: Tensor, before: Tensor) -> Tensor:
    """Return inputs whose missing rows repeat the last there was; NaN where there was none.

    Args:
        ahead: Shape (n, H, m).
        before: What came before, shape (n, W, m).
    """
    whole = torch.cat((before, ahead), 1)
    place = torch.where(torch.isfinite(whole), torch.arange(whole.shape[1])[:, None], -1)
    place = torch.cummax(place, 1).values
    held = whole.gather(1, place.clamp(min=0))
    return torch.where(place >= 0, held, torch.nan)[:, before.shape[1] :]


class Emulated(NamedTuple):
    """Emulated outages, or free runs, cut out of windows: N of them, H rows.

    Attributes:
        target: NaN where there is none, shape (N, H).
        inputs: Shape (N, H, m).
        owner: Satellite of each, int64, shape (N,).
    """

    target: Tensor
    inputs: Tensor
    owner: Tensor


def emulated_outages(windows: RangeWindows, options: RangeErrorOptions) -> Emulated:
    """Return emulated outages within windows, with the inputs that only exist in an outage.

    Args:
        windows: Windows.
        options: Tell inputs, length, and what ``recent`` means.
    """
    satellites, length = windows.target.shape
    horizon = max(1, min(round(options.emulated_s / windows.step), length // 2))
    every = max(1, round(EMULATED_EVERY_S / windows.step))
    starts = torch.arange(1, max(length - horizon + 1, 2), every)
    rows = (starts.unsqueeze(-1) + torch.arange(horizon)).clamp(max=length - 1)
    mean = recent_mean(windows.target, options.average_s / windows.step)
    recent = mean[:, starts - 1].unsqueeze(-1).expand(-1, -1, horizon)
    seen = windows.inputs[:, rows]
    held = _held(recent, windows.step)
    inputs = _in_order(seen, held, options).flatten(0, 1)
    target = windows.target[:, rows].flatten(0, 1)
    known = torch.isfinite(inputs).all(-1)
    owner = torch.arange(satellites).repeat_interleave(len(starts))
    return Emulated(torch.where(known, target, torch.nan), inputs, owner)


def inputs_ahead(windows: RangeWindows, options: RangeErrorOptions) -> Tensor:
    """Return all inputs through the outage, shape (n, H, m).

    Args:
        windows: Windows.
        options: Tell inputs, and what ``recent`` means.
    """
    mean = recent_mean(windows.target, options.average_s / windows.step)[:, -1:]
    recent = mean.expand(-1, windows.ahead.shape[1])
    return _in_order(windows.ahead, _held(recent, windows.step), options)


def _held(recent: Tensor, step: float) -> dict[str, Tensor]:
    delay = step * torch.arange(1, recent.shape[-1] + 1).to(recent)
    return {"recent": recent, "delay": delay.expand_as(recent)}


def _in_order(seen: Tensor, held: dict[str, Tensor], options: RangeErrorOptions) -> Tensor:
    """Return inputs in the order that the options name them."""
    names = options.residual_options().inputs
    columns = {name: seen[..., k] for k, name in enumerate(names)}
    return torch.stack([{**columns, **held}[name] for name in options.inputs], -1)
