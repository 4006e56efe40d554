"""Whether positions follow their own velocities: jumps, slides, axes, invented fixes."""

from typing import Literal

import numpy as np
import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.findings import Part
from navlearn.logs.quality.signals import Array, Mask, Track, column, median_interval, track_of


def check_consistency(log: DriveLog) -> Part:
    """Check fixes and reference against themselves; the log is in order."""
    part = Part()
    _against_velocity(part, log, "fixes")
    _against_velocity(part, log, "reference")
    _check_invented(part, log.fixes)
    return part


def _against_velocity(part: Part, log: DriveLog, name: Literal["fixes", "reference"]) -> None:
    table = log.tables().get(name)
    key = f"{name}_velocity_scale"
    if table is None or len(table) < 10:
        part.not_observable[key] = f"the log has no {name}"
        return
    track = track_of(table)
    if not track.measured:
        part.not_observable[key] = f"the {name} carry no velocity"
        return
    t, rest_e, rest_n = step_residuals(track)
    _check_jumps(part, name, t, rest_e, rest_n, track)
    _check_slide(part, name, t, rest_e, rest_n)
    _check_components(part, name, track)


def step_residuals(track: Track) -> tuple[Array, Array, Array]:
    """Return what each step between positions has beyond the mean of its end velocities.

    Returns:
        Time of the later position, east and north residual, m; steps over gaps are left out.
    """
    t, dt = track.t, np.diff(track.t)
    near = dt < 2.5 * median_interval(t)
    v_e = np.interp(t, track.t_v, track.v_e)
    v_n = np.interp(t, track.t_v, track.v_n)
    rest_e = track.step_e[1:] - 0.5 * (v_e[1:] + v_e[:-1]) * dt
    rest_n = track.step_n[1:] - 0.5 * (v_n[1:] + v_n[:-1]) * dt
    return t[1:][near], rest_e[near], rest_n[near]


def _check_jumps(part: Part, name: str, t: Array, east: Array, north: Array, track: Track) -> None:
    if len(t) < 10:
        return
    size = np.hypot(east, north)
    limit = max(5.0, 8.0 * float(np.median(size)))
    jumps = [int(k) for k in np.flatnonzero(size > limit)]
    part.figures[f"{name}_jumps"] = float(len(jumps))
    part.figures[f"{name}_worst_jump_m"] = float(np.max(size))
    if len(jumps) == 0:
        return
    # Both the step away and the step back of a spike count as returning.
    back = [
        min(
            np.hypot(*_sum(east, north, k, k + 5)),
            np.hypot(*_sum(east, north, max(0, k - 4), k + 1)),
        )
        < 0.5 * size[k]
        for k in jumps
    ]
    worst = int(np.argmax(size))
    part.add(
        "warning" if len(jumps) < 0.2 * len(track.t) else "error",
        "position jumps",
        f"{name} at {t[worst]:.2f} s",
        f"{len(jumps)} steps over {limit:.1f} m beyond what the velocity tells, the worst "
        f"{size[worst]:.1f} m; {sum(back)} return within five fixes, {len(back) - sum(back)} stay",
        "positions that follow their velocity",
        "keep the integrity gate on; a jump that stays may be another antenna or base",
    )


def _sum(east: Array, north: Array, first: int, last: int) -> tuple[float, float]:
    return float(np.sum(east[first:last])), float(np.sum(north[first:last]))


def _check_slide(part: Part, name: str, t: Array, east: Array, north: Array) -> None:
    if len(t) < 10:
        return
    window = max(1, round(30.0 / median_interval(t)))
    if len(t) <= window:
        return
    path = np.hypot(*(_moving_sum(x, window) for x in (east, north)))
    worst = int(np.argmax(path))
    part.figures[f"{name}_slide_30_s_m"] = float(path[worst])
    if name == "reference" and path[worst] > 10.0:
        part.add(
            "warning",
            "sliding reference",
            f"reference at {t[worst + window // 2]:.2f} s",
            f"position and velocity part by {path[worst]:.1f} m within 30 s",
            "a reference that follows its own velocity",
            "score no outage there",
        )


def _moving_sum(x: Array, window: int) -> Array:
    total = np.concatenate(([0.0], np.cumsum(x)))
    return total[window:] - total[:-window]


def _check_components(part: Part, name: str, track: Track) -> None:
    dt = np.diff(track.t)
    near = dt < 2.5 * median_interval(track.t)
    middle = 0.5 * (track.t[1:] + track.t[:-1])[near]
    by_step = np.stack((track.step_e[1:] / dt, track.step_n[1:] / dt))[:, near]
    told = np.stack([np.interp(middle, track.t_v, v) for v in (track.v_e, track.v_n)])
    moving = np.hypot(*told) > 2.0
    if np.count_nonzero(moving) < 20:
        part.not_observable[f"{name}_velocity_scale"] = "too little motion"
        return
    a, b = by_step[:, moving], told[:, moving]
    scale = float(np.median(np.hypot(*a) / np.hypot(*b)))
    part.figures[f"{name}_velocity_scale"] = 1.0 / max(scale, 1e-12)
    straight = float(np.median(np.abs(np.hypot(*(a - scale * b)))))
    swapped = float(np.median(np.abs(np.hypot(*(a - scale * b[::-1])))))
    size = float(np.median(np.hypot(*a)))
    if straight > 0.5 * size:
        hint = (
            "v_e and v_n are exchanged" if swapped < 0.3 * straight else "a sign or axis is wrong"
        )
        part.add(
            "error",
            "velocity axes",
            f"{name} v_e, v_n",
            f"positions move otherwise than the velocity tells: {hint}",
            "v_e to the east, v_n to the north",
            "map the columns in the descriptor",
        )
    elif abs(scale - 1.0) > 0.1:
        part.add(
            "error",
            "velocity unit",
            f"{name} v_e, v_n",
            f"the velocity is {1.0 / scale:.4g} of the motion of the positions",
            "m/s, scale 1",
            "check the unit of velocity and of latitude and longitude",
        )


def _check_invented(part: Part, fixes: pd.DataFrame) -> None:
    if _is_coarse(fixes):
        part.not_observable["fixes_interpolated_share"] = "positions come in steps over 1 cm"
        return
    count, moving = interpolated_fixes(fixes)
    if moving < 20:
        return
    share = count / moving
    part.figures["fixes_interpolated_share"] = share
    if 0.005 < share < 0.9 and count >= 5:
        part.add(
            "info",
            "interpolated fixes",
            "fixes",
            f"{count} of {moving} fixes in motion lie exactly on the line between neighbours",
            "measured positions",
            "do not count them as GNSS: they hide outages that the drive had",
        )


def _is_coarse(fixes: pd.DataFrame) -> bool:
    """Tell whether positions have seven decimals of a degree or fewer."""
    lat = np.degrees(column(fixes, "lat"))
    scaled = lat[np.isfinite(lat)] * 1e7
    return bool(np.all(np.abs(scaled - np.round(scaled)) < 1e-2))


def interpolated_fixes(fixes: pd.DataFrame) -> tuple[int, int]:
    """Return how many fixes in motion are interpolated, and how many are in motion.

    A fix is interpolated where position changes as much before it as after it, to a millimetre.
    """
    track = track_of(fixes)
    if len(track.t) < 3:
        return 0, 0
    dt = np.diff(track.t)
    step_e, step_n = track.step_e[1:], track.step_n[1:]
    even: Mask = np.abs(dt[1:] - dt[:-1]) < 1e-3 * dt[1:]
    moving = even & (np.hypot(step_e, step_n)[1:] > dt[1:])
    bend = np.hypot(np.diff(step_e), np.diff(step_n))
    return int(np.count_nonzero(moving & (bend < 1e-3))), int(np.count_nonzero(moving))
