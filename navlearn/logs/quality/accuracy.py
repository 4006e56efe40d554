"""How good fixes are against the reference."""

import numpy as np
import pandas as pd
import torch

from navlearn.frames import enu_between
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.findings import Part
from navlearn.logs.quality.signals import (
    Array,
    column,
    curve_through,
    median_interval,
)


def check_accuracy(log: DriveLog) -> Part:
    """Check fixes against the reference; the log is in order."""
    part = Part()
    if log.reference is None or len(log.reference) < 3:
        part.not_observable["fix_error_median_m"] = "the log has no reference"
    else:
        _against_reference(part, log.fixes, log.reference)
    return part


def errors_against(
    fixes: pd.DataFrame, reference: pd.DataFrame
) -> tuple[Array, Array, Array, Array]:
    """Return time, east, north and up error of each fix against the reference, m."""
    longest = 2.5 * median_interval(column(reference, "t"))
    t = column(fixes, "t")
    near = [
        torch.from_numpy(_reference_at(reference, name, t, longest))
        for name in ("lat", "lon", "height")
    ]
    own = [torch.from_numpy(column(fixes, name).copy()) for name in ("lat", "lon", "height")]
    near[2], own[2] = near[2].nan_to_num(0.0), own[2].nan_to_num(0.0)
    east, north, up = (x.numpy() for x in enu_between(*own, *near))
    lacking = "height" not in fixes or "height" not in reference
    return t, east, north, np.full(len(t), np.nan) if lacking else up


def _reference_at(reference: pd.DataFrame, name: str, t: Array, longest: float) -> Array:
    t_r, x = column(reference, "t"), column(reference, name)
    known = np.isfinite(x)
    return curve_through(t_r[known], x[known], longest=longest)(t)


def _against_reference(part: Part, fixes: pd.DataFrame, reference: pd.DataFrame) -> None:
    t, east, north, up = errors_against(fixes, reference)
    known = np.isfinite(east + north)
    if np.count_nonzero(known) < 3:
        part.not_observable["fix_error_median_m"] = "no fix lies within the reference's time"
        return
    t, east, north, up = t[known], east[known], north[known], up[known]
    error = np.hypot(east, north)
    median, most = (float(np.quantile(error, q)) for q in (0.5, 0.95))
    worst = int(np.argmax(error))
    part.figures |= {
        "fix_error_median_m": median,
        "fix_error_95_m": most,
        "fix_error_worst_m": float(error[worst]),
        "fix_error_worst_at_s": float(t[worst]),
        "fixes_over_10_m": float(np.count_nonzero(error > 10.0)),
    }
    if error[worst] > max(20.0, 10.0 * median):
        part.add(
            "warning",
            "outlying fixes",
            f"fixes at {t[worst]:.2f} s",
            f"{np.count_nonzero(error > 10.0)} fixes over 10 m off the reference, the worst "
            f"{error[worst]:.1f} m (median {median:.2f} m, 95 % {most:.1f} m)",
            "errors of a few metres",
            "keep the integrity gate on; place no scored outage there",
        )
    if median > 15.0:
        part.add(
            "error",
            "fixes beside the reference",
            "fixes",
            f"median distance {median:.1f} m",
            "a few metres",
            "check datum, units and clock of both tables",
        )
    _check_datum(part, up)
    _note_lever_arm(part, reference, t, east, north)


def _check_datum(part: Part, up: Array) -> None:
    up = up[np.isfinite(up)]
    if len(up) < 3:
        return
    offset = float(np.median(up))
    part.figures["height_offset_m"] = offset
    if abs(offset) > 10.0:
        part.add(
            "warning",
            "height datum",
            "fixes height",
            f"fixes lie {offset:+.1f} m from the reference's height (median)",
            "both above the ellipsoid",
            "one of them is above mean sea level: add the geoid's height in the descriptor",
        )


def _note_lever_arm(
    part: Part, reference: pd.DataFrame, t: Array, east: Array, north: Array
) -> None:
    azimuth = column(reference, "azimuth")
    known = np.isfinite(azimuth)
    if np.count_nonzero(known) < 10:
        return
    a = np.interp(t, column(reference, "t")[known], np.unwrap(azimuth[known]))
    part.figures["fix_offset_right_m"] = float(np.median(east * np.cos(a) - north * np.sin(a)))
    part.figures["fix_offset_forward_m"] = float(np.median(east * np.sin(a) + north * np.cos(a)))
