"""The position error of a free-running INS as a record, one axis at a time.

[Jaradat2017] §III: the target is y = δP = reference − INS, the regressors are
u = [P_INS, P_GPS, d], with the last fix held and d the INS steps since. Row t + 1 pairs y(t + 1)
with u(t), as the paper's (14) does: a fix taken at t + 1 is in the target alone, or the network
would be handed its answer. Between fixes there is no target; the paper took it from another
instrument, here it lies on the straight line from one fix's GNSS − INS to the next. Nothing but
fixes is read.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError, FitError, ShapeError

SERIES_INPUTS: Final[dict[str, str]] = {
    "ins_position": "m",
    "gnss_position": "m",
    "delay_steps": "steps",
}
"""Regressors of the paper, by unit: P_INS, P_GPS held since the last fix, d."""


class PositionSeries(NamedTuple):
    """T samples from a first fix on; axes are those of the positions given.

    Attributes:
        t: Time, s, shape (T,).
        ins: Position of the free-running INS, m, shape (T, 3).
        held: The last fix, m, shape (T, 3).
        delay: INS steps since that fix, shape (T,).
        target: GNSS − INS at fixes, on straight lines between them, m, shape (T, 3).
        at_fix: Where a fix was taken, bool, shape (T,).
        known: Where there is a target: up to the last fix, bool, shape (T,).
    """

    t: Tensor
    ins: Tensor
    held: Tensor
    delay: Tensor
    target: Tensor
    at_fix: Tensor
    known: Tensor


def position_series(t: Tensor, ins: Tensor, index: Tensor, fix: Tensor) -> PositionSeries:
    """Return the record that begins with the first fix.

    Args:
        t: Time at the end of every interval, s, shape (T,).
        ins: Position of the INS then, in Cartesian axes, m, shape (T, 3).
        index: Samples at which fixes are used, int64, not decreasing, shape (M,); of several at
            one sample the last counts.
        fix: Positions of the fixes in the same axes, m, shape (M, 3).

    Raises:
        ShapeError: The shapes do not belong together, or an index lies outside the record.
        FitError: There are fewer than two fixes.
    """
    if ins.shape != (*t.shape, 3) or fix.shape != (*index.shape, 3) or t.ndim != 1:
        raise ShapeError(
            f"position series: t {tuple(t.shape)}, ins {tuple(ins.shape)}, index "
            f"{tuple(index.shape)} and fix {tuple(fix.shape)}; expected (T,), (T, 3), (M,), (M, 3)"
        )
    if index.numel() and not 0 <= int(index.min()) <= int(index.max()) < len(t):
        raise ShapeError(
            f"position series: fixes at samples {int(index.min())} to {int(index.max())} of "
            f"{len(t)}; leave out those that fall outside"
        )
    last = torch.ones_like(index, dtype=torch.bool)
    last[:-1] = index[1:] != index[:-1]
    index, fix = index[last], fix[last]
    if len(index) < 2:
        raise FitError(
            f"position series: {len(index)} fixes; a position error can be learned from two or more"
        )
    first = int(index[0])
    t, ins, index = t[first:], ins[first:], index - first
    row = torch.arange(len(t))
    latest = torch.searchsorted(index, row, right=True) - 1
    at_fix = torch.zeros(len(t), dtype=torch.bool)
    at_fix[index] = True
    return PositionSeries(
        t=t,
        ins=ins,
        held=fix[latest],
        delay=(row - index[latest]).double(),
        target=_between_fixes(t, index, fix - ins[index]),
        at_fix=at_fix,
        known=row <= index[-1],
    )


def _between_fixes(t: Tensor, index: Tensor, error: Tensor) -> Tensor:
    """Return errors on straight lines between fixes, and the last one after the last."""
    row = torch.arange(len(t))
    left = (torch.searchsorted(index, row, right=True) - 1).clamp(max=len(index) - 2)
    begin, end = t[index[left]], t[index[left + 1]]
    share = ((t - begin) / (end - begin)).clamp(0.0, 1.0).unsqueeze(-1)
    return error[left] + share * (error[left + 1] - error[left])


def series_inputs(series: PositionSeries, axis: int, names: tuple[str, ...]) -> Tensor:
    """Return the regressors of one axis, sample by sample, shape (T, m).

    Args:
        series: The record.
        axis: Index of the axis.
        names: Any of :data:`SERIES_INPUTS`, in the order wanted.

    Raises:
        ConfigError: A name is unknown, or there is none.
    """
    unknown = [name for name in names if name not in SERIES_INPUTS]
    if unknown or not names:
        raise ConfigError(
            f"position series: {', '.join(unknown) or 'no input named'}; choose from "
            f"{', '.join(SERIES_INPUTS)}"
        )
    channels = {
        "ins_position": series.ins[:, axis],
        "gnss_position": series.held[:, axis],
        "delay_steps": series.delay,
    }
    return torch.stack([channels[name] for name in names], -1)


def without_fixes_after(series: PositionSeries, row: int) -> PositionSeries:
    """Return the record as it would be if no fix had come after a row.

    Args:
        series: The record.
        row: The last row at which a fix may have been taken.
    """
    steps = torch.arange(len(series.t)) - row
    after = steps > 0
    return series._replace(
        held=torch.where(after.unsqueeze(-1), series.held[row], series.held),
        delay=torch.where(after, series.delay[row] + steps, series.delay),
        at_fix=series.at_fix & ~after,
        known=series.known & ~after,
    )
