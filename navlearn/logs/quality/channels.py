"""Whether every channel lives: empty, frozen, saturated or coarse values."""

import numpy as np
from numpy.typing import NDArray

from navlearn.logs import columns
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.findings import Part
from navlearn.logs.quality.signals import Array, Mask, column, median_interval, track_of

Indices = NDArray[np.intp]

_FROZEN = 2.0
"""Run of identical inertial values, in motion, that is no accident, s."""

_STUCK = 8.0
"""Run of identical odometer speeds or positions that is no accident, s."""


def check_channels(log: DriveLog) -> Part:
    """Check the values of every channel of a log that is in order."""
    part = Part()
    for name, table in log.tables().items():
        if len(table) < 2 or name == "ranges":
            continue
        for channel in columns.TABLES[name]:
            if channel in table:
                _check_empty(part, name, channel, column(table, "t"), column(table, channel))
                _measure_step(part, name, channel, column(table, channel))
    for channel in columns.IMU:
        if channel in log.imu and channel != "temperature":
            _check_frozen(part, log, channel)
            _check_saturated(part, channel, column(log.imu, "t"), column(log.imu, channel))
    _check_stuck_odometer(part, log)
    _check_stuck_fixes(part, log)
    return part


def runs(same: Mask) -> tuple[Indices, Indices]:
    """Return first and last index of each run of True."""
    edge = np.diff(np.concatenate(([0], same.astype(np.int8), [0])))
    return np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1


def quantisation_step(x: Array) -> float | None:
    """Return the step in which values come, or None where they are continuous."""
    finite = x[np.isfinite(x)]
    levels = np.unique(finite)
    if len(levels) < 4 or len(levels) > 0.2 * len(finite):
        return None
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-6 * (levels[-1] - levels[0])]
    low = float(np.quantile(gaps, 0.1))
    step = float(np.mean(gaps[gaps < 1.5 * low]))
    away = gaps / step - np.round(gaps / step)
    return step if np.mean(np.abs(away) < 0.05) > 0.9 else None


def in_motion(log: DriveLog, t: Array) -> Mask | None:
    """Tell at which times the car moves, None where nothing but the IMU could tell."""
    t_o, speed = column(log.odometer, "t"), np.abs(column(log.odometer, "speed"))
    known = np.isfinite(speed)
    if np.count_nonzero(known) > 1:
        return np.asarray(np.interp(t, t_o[known], speed[known], left=0.0, right=0.0) > 1.0)
    track = track_of(log.fixes)
    if len(track.t_v) > 1:
        # Differences of noisy positions move at a standstill too.
        pace = 2.0 if track.measured else 5.0
        return np.asarray(np.interp(t, track.t_v, track.speed, left=0.0, right=0.0) > pace)
    return None


def _check_empty(part: Part, table: str, channel: str, t: Array, x: Array) -> None:
    empty = ~np.isfinite(x)
    share = float(np.mean(empty))
    if share == 0.0 or (share == 1.0 and channel not in columns.REQUIRED[table]):
        return
    if channel not in columns.REQUIRED[table] or channel == "lon":
        return
    part.figures[f"{table}_{channel}_missing_share"] = share
    first, last = runs(empty)
    length = t[last] - t[first] + median_interval(t)
    worst = int(np.argmax(length))
    found = (
        f"{channel} empty in {np.count_nonzero(empty)} of {len(x)} rows, "
        f"longest for {length[worst]:.2f} s"
    )
    sensor = table in ("imu", "odometer")
    ruinous = share > 0.5 or (sensor and length[worst] > 10.0)
    part.add(
        "error" if ruinous else "warning" if sensor else "info",
        "empty values",
        f"{table} at {t[first[worst]]:.2f} s",
        found,
        "a value in every row" if sensor else "a position in every row while GNSS is there",
        "fill short blocks when resampling, cut long ones out"
        if sensor
        else "nothing: such rows are no fixes",
    )


def _measure_step(part: Part, table: str, channel: str, x: Array) -> None:
    if table == "reference" or channel in ("satellites", "temperature"):
        return
    step = quantisation_step(x)
    if step is not None:
        part.figures[f"{table}_{channel}_step"] = step


def _check_frozen(part: Part, log: DriveLog, channel: str) -> None:
    t, x = column(log.imu, "t"), column(log.imu, channel)
    if len(x) < 10:
        return
    if np.nanmax(x, initial=-np.inf) <= np.nanmin(x, initial=np.inf):
        _report_dead(part, channel, x)
        return
    moving = in_motion(log, t)
    first, last = runs(x[1:] == x[:-1])
    length = t[np.minimum(last + 1, len(t) - 1)] - t[first]
    needed = _FROZEN if moving is not None else 5.0 * _FROZEN
    suspicious = (length > needed) & (last - first > 10)
    stretches = [
        (float(t[a]), float(span))
        for a, b, span in zip(
            first[suspicious], last[suspicious] + 1, length[suspicious], strict=True
        )
        if _should_change(log, channel, moving, int(a), int(b))
    ]
    if stretches:
        total = float(sum(span for _, span in stretches))
        part.add(
            "error" if total > 10.0 or channel == "gyro_z" else "warning",
            "frozen channel",
            f"imu {channel} at {stretches[0][0]:.2f} s",
            f"{len(stretches)} runs of one value in motion, {total:.1f} s in all",
            "values that change while the car moves",
            "treat those rows as missing, or cut them out",
        )


def _report_dead(part: Part, channel: str, x: Array) -> None:
    if not np.any(np.isfinite(x)):
        return
    part.add(
        "error" if channel == "gyro_z" else "info",
        "dead channel",
        f"imu {channel}",
        f"one value throughout ({x[np.isfinite(x)][0]:g})",
        "a sensor that moves",
        "map the right column, or leave the channel out",
    )


def _should_change(log: DriveLog, channel: str, moving: Mask | None, first: int, last: int) -> bool:
    if moving is not None:
        return bool(np.mean(moving[first : last + 1]) > 0.8)
    others = [name for name in columns.IMU if name in log.imu and name != channel]
    rows = log.imu.iloc[first : last + 1]
    return any(len(np.unique(column(rows, name))) > 5 for name in others)


def _is_noiseless(x: Array) -> bool:
    """Tell whether a signal is too smooth for a plateau to mean clipping, as in simulation."""
    bend = float(np.median(np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2])))
    return bend < 1e-5 * float(np.max(x) - np.min(x))


def _check_saturated(part: Part, channel: str, t: Array, x: Array) -> None:
    finite = np.isfinite(x)
    values = x[finite]
    if len(values) < 100 or np.min(values) == np.max(values):
        return
    middle = float(np.median(values))
    step = quantisation_step(values) or 0.0
    if step == 0.0 and _is_noiseless(values):
        return
    for sign, word in ((1.0, "upper"), (-1.0, "lower")):
        reach = sign * (values - middle)
        end = float(np.max(reach))
        at_end = np.count_nonzero(reach >= end * (1.0 - 1e-9))
        close = np.count_nonzero(reach > 0.8 * end) - at_end
        if end > 15.0 * step and at_end >= 10 and at_end > 2 * close:
            where = float(t[finite][int(np.argmax(reach))])
            part.add(
                "error" if channel == "gyro_z" else "warning",
                "saturated channel",
                f"imu {channel} at {where:.2f} s",
                f"{at_end} samples at the {word} end {middle + sign * end:.4g}, "
                f"{close} in the last fifth before it",
                "fewer and fewer samples towards the extremes",
                "set the sensor's range wider, or treat those rows as missing",
            )


def _check_stuck_odometer(part: Part, log: DriveLog) -> None:
    t, x = column(log.odometer, "t"), column(log.odometer, "speed")
    track = track_of(log.fixes)
    if len(t) < 10 or len(track.t_v) < 10 or not track.measured:
        return
    first, last = runs(x[1:] == x[:-1])
    stuck = []
    for a, b in zip(first, last + 1, strict=True):
        inside = (track.t_v > t[a] + 2.0) & (track.t_v < t[b] - 2.0)
        if t[b] - t[a] < _STUCK or b - a < 5 or np.count_nonzero(inside) < 3:
            continue
        low, high = np.quantile(track.speed[inside], (0.1, 0.9))
        if high - low > 3.0 or (x[a] == 0.0 and low > 3.0):
            stuck.append((t[a], t[b] - t[a]))
    if stuck:
        total = sum(length for _, length in stuck)
        part.add(
            "error",
            "frozen channel",
            f"odometer speed at {stuck[0][0]:.2f} s",
            f"{len(stuck)} runs of one value, {total:.1f} s in all, while the fixes tell of motion",
            "speed that follows the car",
            "treat those rows as missing, or cut them out",
        )


def _check_stuck_fixes(part: Part, log: DriveLog) -> None:
    t, lat, lon = (column(log.fixes, name) for name in ("t", "lat", "lon"))
    if len(t) < 3:
        return
    same = (lat[1:] == lat[:-1]) & (lon[1:] == lon[:-1])
    speed = np.abs(column(log.odometer, "speed"))
    known = np.isfinite(speed)
    if np.count_nonzero(known) < 2:
        return
    pace = np.interp(t[1:], column(log.odometer, "t")[known], speed[known], left=0.0, right=0.0)
    held = same & (pace > 2.0)
    part.figures["fixes_repeated_in_motion"] = float(np.count_nonzero(held))
    if np.any(held):
        count = int(np.count_nonzero(held))
        part.add(
            "warning",
            "repeated fixes",
            f"fixes at {t[1:][held][0]:.2f} s",
            f"{count} fixes repeat the position before while the car moves",
            "a new position each time",
            "drop repeated fixes in the reader: the filter would trust them",
        )
