"""A drive as filters take it, with its reference at the same moments."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.errors import FitError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.reference import reference_at
from navlearn.logs.resample import RissTimeline
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, Trajectory

COURSE_SPEED = 3.0
"""Where a reference has no azimuth, the direction of travel above this speed serves, m/s."""


class ReferencedDrive(NamedTuple):
    """A drive and its reference; what the reference does not tell is NaN.

    Attributes:
        name: The log's name.
        samples: Intervals, shape (T,) each.
        fixes: Fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.
        reference: At the begin of the first interval and the end of every interval, shape (T+1,)
            each; azimuth not wrapped.
        at_fixes: The reference when each fix was valid, shape (M,) each.
        lever_arm: Antenna from the point that navigates, body RFU, m.
    """

    name: str
    samples: RissSample
    fixes: GnssFix
    timing: FixTiming
    reference: Trajectory
    at_fixes: Trajectory
    lever_arm: tuple[float, float, float]


def referenced_drive(
    log: DriveLog,
    timeline: RissTimeline,
    lever_arm: tuple[float, float, float] | None = None,
) -> ReferencedDrive:
    """Return a drive beside its reference.

    Args:
        log: The drive, its latencies removed, with a reference.
        timeline: The same as tensors.
        lever_arm: Antenna from the point that navigates, body RFU, m; None takes the log's.

    Raises:
        LogError: The log has no reference.
        FitError: The reference tells neither azimuth nor velocity.
    """
    edges = torch.cat((torch.tensor([timeline.start_time], dtype=torch.float64), timeline.t))
    return ReferencedDrive(
        log.metadata.name,
        timeline.samples,
        timeline.fixes,
        timeline.timing,
        _trajectory(log, edges),
        _trajectory(log, timeline.fix_time),
        log.metadata.lever_arm if lever_arm is None else lever_arm,
    )


def states_at(trajectory: Trajectory, index: Tensor) -> NavState:
    """Return position and azimuth at some places of a trajectory.

    Args:
        trajectory: Shape (T,) each.
        index: Places, int64, shape (K,).
    """
    return NavState(*(channel[index] for channel in trajectory[:4]))


def _trajectory(log: DriveLog, t: Tensor) -> Trajectory:
    table = reference_at(log, t)

    def column(name: str) -> Tensor:
        if name not in table:
            return torch.full_like(t, torch.nan)
        return torch.tensor(table[name].to_numpy(np.float64))

    v_e, v_n = column("v_e"), column("v_n")
    azimuth = column("azimuth")
    if not bool(azimuth.isfinite().any()):
        fast = torch.hypot(v_e, v_n) > COURSE_SPEED
        azimuth = torch.where(fast, torch.atan2(v_e, v_n), torch.nan)
    if len(t) and not bool(azimuth.isfinite().any()):
        raise FitError(
            f"{log.metadata.name}: its reference tells neither azimuth nor a velocity above "
            f"{COURSE_SPEED:g} m/s; dead reckoning cannot be held against it"
        )
    height = column("height")
    return Trajectory(
        column("lat"), column("lon"), height, _unwrapped(azimuth), v_e, v_n, column("v_u")
    )


def _unwrapped(angle: Tensor) -> Tensor:
    """Return angles without jumps of a turn; what is unknown stays so."""
    known = angle.isfinite()
    found = angle[known]
    if len(found) == 0:
        return angle
    steps = wrap_angle(torch.diff(found))
    whole = angle.clone()
    whole[known] = found[0] + torch.cat((steps.new_zeros(1), torch.cumsum(steps, 0)))
    return whole
