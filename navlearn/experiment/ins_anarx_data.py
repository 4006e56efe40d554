"""What [Jaradat2017] learns from: a free-running INS beside the fixes of a known log.

The INS runs from the drive's alignment, or from what the filter believed where a stated window
begins, with the sensor errors known there and none learned later; nothing corrects it any more.
Positions are Earth-fixed. The antenna's lever arm is taken off by the INS's own attitude.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import matrix_from_quaternion
from navlearn.errors import FitError
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.frames import ecef_from_geodetic, enu_from_ecef_matrix
from navlearn.ins_navigator import InsNavigator, InsNavigatorRun, ins_belief_at
from navlearn.learning.position_series import PositionSeries, position_series
from navlearn.logs.imu_timeline import ImuTimeline
from navlearn.states import ImuSample, InsState


class FreeIns(NamedTuple):
    """A free-running INS and its record.

    Attributes:
        series: The record, from the first fix on; Earth-fixed axes.
        path: The INS over its rows, shape (T,) each.
        first: Sample of the filter's run that is its first row.
    """

    series: PositionSeries
    path: InsState
    first: int


def free_ins(
    line: ImuTimeline,
    navigator: InsNavigator,
    run: InsNavigatorRun,
    *,
    since: float | None = None,
) -> FreeIns:
    """Return the record of an INS that runs free to the end of a log.

    Args:
        line: The log as tensors.
        navigator: What made the run.
        run: The filter over the log.
        since: The INS starts at the first fix from this time on, s; None starts it where the
            drive was aligned.

    Raises:
        FitError: There are fewer than two fixes after the start.
    """
    belief, begin = _start(line, navigator, run, since)
    samples = ImuSample(*(channel[begin:].unsqueeze(0) for channel in run.samples))
    coast = navigator.coast(map_ins_belief(belief, lambda channel: channel.unsqueeze(0)), samples)
    path = InsState(*(channel[0] for channel in coast))
    index = line.timing.index - run.first - begin
    usable = (index >= 0) & (index < len(path.lat)) & (line.fixes.has_position > 0)
    index, late = index[usable], line.timing.delay[usable]
    antenna = ecef_from_geodetic(
        line.fixes.lat[usable], line.fixes.lon[usable], line.fixes.height[usable]
    )
    there = InsState(*(channel[index] for channel in path))
    fix = antenna + moved_since(there, late, navigator.options.filter.lever_arm)
    t = line.t[run.first + begin :]
    position = ecef_from_geodetic(path.lat, path.lon, path.height)
    series = position_series(t, position, index, fix)
    cut = len(t) - len(series.t)
    return FreeIns(series, InsState(*(channel[cut:] for channel in path)), begin + cut)


def _start(
    line: ImuTimeline, navigator: InsNavigator, run: InsNavigatorRun, since: float | None
) -> tuple[InsBelief, int]:
    """Return what the INS starts with, and its first sample."""
    t = line.t[run.first :]
    if since is None or since <= float(t[0]):
        return navigator.start(run.alignment), 0
    late = (t[run.history.end] >= since) & (run.history.fix >= 0)
    if not bool(late.any()):
        raise FitError(
            f"free-running INS: no fix from {since:.1f} s on, so there is nowhere to start it; "
            "learn from a longer window"
        )
    block = int(torch.nonzero(late)[0])
    return ins_belief_at(run.history, block), int(run.history.end[block]) + 1


def moved_since(path: InsState, late: Tensor, arm: tuple[float, float, float]) -> Tensor:
    """Return the way from an antenna, some time ago, to the IMU now, Earth-fixed, m, (..., 3).

    Args:
        path: The INS now, shape (...).
        late: How long ago, s, shape (...).
        arm: Antenna from the IMU, body RFU, m.
    """
    lever = torch.tensor(arm, dtype=torch.float64)
    to_antenna = torch.matmul(matrix_from_quaternion(path.q_lb), lever)
    way = path.v_l * late.unsqueeze(-1) - to_antenna
    c_el = enu_from_ecef_matrix(path.lat, path.lon).transpose(-1, -2)
    return torch.matmul(c_el, way.unsqueeze(-1)).squeeze(-1)
