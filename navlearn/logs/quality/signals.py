"""The signals that checks compare: tracks, velocities, turned angles, standstills.

Arrays are NumPy float64. Headings here are anticlockwise from east, like the integral of the yaw
rate, so that one may be compared with the other without a sign; all are unwrapped.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from navlearn.frames import enu_between
from navlearn.logs.drive_log import DriveLog

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Track:
    """Positions and velocities of fixes or reference, with the rows that lack them left out.

    Attributes:
        t: Times of the positions, s.
        step_e: From the position before, to the east, m; the first is zero.
        step_n: From the position before, to the north, m.
        t_v: Times of the velocities, s.
        v_e: Velocity to the east, m/s.
        v_n: Velocity to the north, m/s.
        measured: Whether velocities were measured; if not, they are the differences of
            positions at the middle of their intervals.
    """

    t: Array
    step_e: Array
    step_n: Array
    t_v: Array
    v_e: Array
    v_n: Array
    measured: bool

    @property
    def speed(self) -> Array:
        """Horizontal speed at ``t_v``, m/s."""
        return np.hypot(self.v_e, self.v_n)

    @property
    def heading(self) -> Array:
        """Direction of motion at ``t_v``, rad, anticlockwise from east, unwrapped."""
        return np.unwrap(np.arctan2(self.v_n, self.v_e))


def column(table: pd.DataFrame, name: str) -> Array:
    """Return a column as float64, NaN throughout where the table lacks it."""
    if name not in table:
        return np.full(len(table), np.nan)
    return np.asarray(table[name], dtype=np.float64)


def in_order(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with a finite time, sorted, the first of each time (and satellite)."""
    finite = table[np.isfinite(column(table, "t"))]
    once = ["t", "satellite"] if "satellite" in table else ["t"]
    return finite.sort_values("t", kind="stable").drop_duplicates(once).reset_index(drop=True)


def median_interval(t: Array) -> float:
    """Return the median interval between samples, s, NaN with fewer than two."""
    return float(np.median(np.diff(t))) if len(t) > 1 else float("nan")


def looks_like_degrees(table: pd.DataFrame) -> bool:
    """Tell whether latitude or longitude leave the range that radians can have."""
    lat, lon = np.abs(column(table, "lat")), np.abs(column(table, "lon"))
    beyond = (lat > 0.5 * np.pi + 1e-6) | (lon > 2.0 * np.pi + 1e-6)
    known = int(np.count_nonzero(np.isfinite(lat + lon)))
    return int(np.count_nonzero(beyond)) > max(1, known) // 2


def track_of(table: pd.DataFrame) -> Track:
    """Return the track of a table with ``lat`` and ``lon`` that is in order."""
    lat, lon = column(table, "lat"), column(table, "lon")
    placed = np.isfinite(lat) & np.isfinite(lon)
    rows = table[placed]
    t, lat, lon = column(rows, "t"), lat[placed], lon[placed]
    east, north = _steps(lat, lon, column(rows, "height"))
    v_e, v_n = column(rows, "v_e"), column(rows, "v_n")
    known = np.isfinite(v_e) & np.isfinite(v_n)
    measured = bool(np.count_nonzero(known) > 0.5 * len(t))
    if measured:
        t_v, v_e, v_n = t[known], v_e[known], v_n[known]
    else:
        t_v, v_e, v_n = _differenced(t, east, north)
    return Track(t=t, step_e=east, step_n=north, t_v=t_v, v_e=v_e, v_n=v_n, measured=measured)


def _steps(lat: Array, lon: Array, height: Array) -> tuple[Array, Array]:
    if len(lat) < 2:
        return np.zeros(len(lat)), np.zeros(len(lat))
    level = np.where(np.isfinite(height), height, 0.0)
    now = [torch.from_numpy(x[1:].copy()) for x in (lat, lon, level)]
    before = [torch.from_numpy(x[:-1].copy()) for x in (lat, lon, level)]
    east, north, _ = enu_between(*now, *before)
    return np.append(0.0, east.numpy()), np.append(0.0, north.numpy())


def _differenced(t: Array, east: Array, north: Array) -> tuple[Array, Array, Array]:
    dt = np.diff(t)
    near = dt < 2.5 * median_interval(t) if len(t) > 1 else np.zeros(0, dtype=np.bool_)
    middle = 0.5 * (t[1:] + t[:-1])
    return middle[near], (east[1:] / dt)[near], (north[1:] / dt)[near]


def integral(log: DriveLog, name: str) -> Array:
    """Return the running integral of a channel of ``imu`` at its times, NaN taken as zero.

    Steps where the metadata call the samples means over the interval before them, straight
    lines between samples otherwise.
    """
    t, rate = column(log.imu, "t"), column(log.imu, name)
    filled = np.where(np.isfinite(rate), rate, 0.0)
    steps = "imu" in log.metadata.interval_means
    mean = filled[1:] if steps else 0.5 * (filled[1:] + filled[:-1])
    return np.concatenate(([0.0], np.cumsum(np.diff(t) * mean)))


def near_any(t: Array, marks: Array, margin: float) -> Mask:
    """Tell which times lie within a margin of any of the sorted marks."""
    if len(marks) == 0:
        return np.zeros(len(t), dtype=np.bool_)
    after = np.clip(np.searchsorted(marks, t), 0, len(marks) - 1)
    before = np.clip(after - 1, 0, None)
    return np.minimum(np.abs(marks[after] - t), np.abs(t - marks[before])) <= margin


def standstill(log: DriveLog, *, margin: float = 2.0, speed: float = 0.05) -> Mask:
    """Tell for each IMU sample whether the car stood still, by odometer and by fixes.

    Looks both ways in time, so it serves calibration, not a running filter.

    A sample counts as still when no sample of the odometer within a margin moves (the margin
    covers its latency and its step) and, where fixes carry velocities, none of them does.

    Args:
        log: The log, in order.
        margin: Time kept away from any motion, s.
        speed: Odometer speed up to which the car stands, m/s.

    Returns:
        Mask over the rows of ``imu``; all False where nothing tells.
    """
    t = column(log.imu, "t")
    still = np.zeros(len(t), dtype=np.bool_)
    t_o, v_o = column(log.odometer, "t"), column(log.odometer, "speed")
    known = np.isfinite(v_o)
    if np.any(known):
        still = near_any(t, t_o[known], margin)
        still &= ~near_any(t, t_o[known & (np.abs(v_o) > speed)], margin)
    track = track_of(log.fixes)
    if track.measured:
        still_by_fix = ~near_any(t, track.t_v[track.speed > max(speed, 0.5)], margin)
        covered = near_any(t, track.t_v, margin)
        still = still & (still_by_fix | ~covered) if np.any(known) else still_by_fix & covered
    return still


def curve_through(t: Array, x: Array, *, longest: float) -> Callable[[Array], Array]:
    """Return a smooth signal as a function of time, NaN outside it and inside its gaps.

    Args:
        t: Times of the samples, increasing, s.
        x: Samples.
        longest: Intervals longer than this are gaps, s.
    """
    if len(t) < 2:
        return lambda at: np.full(len(at), np.nan)
    through = PchipInterpolator(t, x, extrapolate=False)

    def curve(at: Array) -> Array:
        right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
        return np.where(t[right] - t[right - 1] > longest, np.nan, through(at))

    return curve
