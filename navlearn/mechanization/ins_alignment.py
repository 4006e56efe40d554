"""Alignment of a full IMU: the first state from which a strapdown or a filter can run.

A car that has stood is levelled on its accelerometers and takes its azimuth from the course of the
first fast fix; a drive that starts in motion is aligned by velocity matching.
"""

import math

import torch
from torch import Tensor

from navlearn.errors import LogError
from navlearn.mechanization.confirmed_standstill import confirmed_standstill
from navlearn.mechanization.ins_alignment_result import (
    InsAlignment,
    InsAlignmentOptions,
    stated_alignment,
)
from navlearn.mechanization.levelled_alignment import drives_forward, levelled_at, rest_before
from navlearn.mechanization.matched_alignment import matched_at
from navlearn.states import FixTiming, GnssFix, ImuSample

__all__ = ["InsAlignment", "InsAlignmentOptions", "align_ins", "stated_alignment"]

RETRY = 2.0
"""A window of velocity matching that told too little is tried again after this time, s."""


def align_ins(
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    options: InsAlignmentOptions | None = None,
    *,
    bridged: Tensor | None = None,
) -> InsAlignment:
    """Return the first state from which a full-IMU filter can run.

    Args:
        samples: Intervals of one drive, shape (T,) and (T, 3) each.
        fixes: Fixes, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        options: Thresholds and standard deviations; None means the defaults.
        bridged: Where a gap in the IMU was bridged, bool, shape (T,): no attitude is carried
            across one; None means nowhere.

    Returns:
        The alignment, from nothing later than its own fix.

    Raises:
        LogError: If the drive tells no attitude by the method asked for.
    """
    options = options or InsAlignmentOptions()
    samples = confirmed_standstill(samples, fixes, timing)
    clock = torch.cumsum(samples.dt, 0)
    usable = (timing.index >= 0) & (fixes.has_position > 0) & (fixes.has_velocity > 0)
    tried, best = -math.inf, math.inf
    for m in torch.nonzero(usable)[:, 0].tolist():
        end = int(timing.index[m])
        if options.method != "velocity_matching":
            rest = rest_before(samples, end, options, bridged)
            if rest is not None and drives_forward(samples, fixes, timing, m, options.speed):
                return levelled_at(samples, fixes, timing, m, rest, options)
            if rest is not None or options.method == "levelled+course":
                continue
        if float(clock[end]) - tried < RETRY:
            continue
        found = matched_at(samples, fixes, timing, m, options, bridged=bridged)
        if found is None:
            continue
        tried, sigma = float(clock[end]), found.attitude_sigma
        if sigma[2] <= options.azimuth_sigma and float(sigma[:2].max()) <= options.tilt_sigma:
            return found
        best = min(best, float(sigma[2]))
    raise LogError(_advice(fixes, usable, best, options))


def _advice(fixes: GnssFix, usable: Tensor, best: float, options: InsAlignmentOptions) -> str:
    where = f"full-IMU alignment ({options.method})"
    count = int(usable.sum())
    if count == 0:
        return (
            f"{where}: none of {usable.numel()} fixes has both position and velocity, which an "
            "attitude is found from; use a log whose receiver tells velocity, or whose raw ranges "
            "have range rates that fixes can be made from (with_single_point_fixes)"
        )
    fastest = float(torch.hypot(fixes.v_e, fixes.v_n)[usable].max())
    if options.method == "levelled+course":
        return (
            f"{where}: no fix faster than {options.speed:g} m/s within {options.carry:g} s after a "
            f"standstill of {options.standstill:g} s (fastest fix {fastest:.2f} m/s); use method "
            "velocity_matching, a longer stretch before the first outage, or a smaller standstill"
        )
    told = "none" if best == math.inf else f"azimuth to {math.degrees(best):.1f}° at best"
    return (
        f"{where}: no window of up to {options.window:g} s with {options.least_fixes} GNSS "
        f"velocities tells azimuth to {math.degrees(options.azimuth_sigma):.1f}° (found: {told}; "
        f"{count} fixes, the fastest {fastest:.2f} m/s); give a stretch of driving with turns or "
        "changing speed before the first outage, or raise InsAlignmentOptions.azimuth_sigma"
    )
