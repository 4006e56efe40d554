"""The motion of a recorded trajectory: simulated sensors on a road that somebody drove.

Positions are smoothed by cubic smoothing splines; speed and course of the result command the
splines of :class:`~navlearn.logs.synthetic.motion.Motion`. The simulated truth is exact for
that motion and follows the record to about a per cent of the way. The car drives forwards.
"""

import numpy as np
import pandas as pd
import torch
from scipy.interpolate import make_smoothing_spline

from navlearn.errors import LogError
from navlearn.frames import enu_between
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.motion import (
    KNOT_DISTANCE,
    KNOT_INTERVAL,
    Motion,
    uniform_spline,
)

STANDING = 0.25
"""Slower than this the recorded car stands, m/s."""

COURSE_SPEED = 1.0
"""Slower than this its course says nothing, m/s."""

SLOPE_WAY = 50.0
"""Way over which heights are averaged into slopes, m."""


def motion_from_trajectory(table: pd.DataFrame, *, smoothing: float = 0.5) -> Motion:
    """Return the smooth motion of a recorded trajectory.

    Args:
        table: Columns ``t`` (s, increasing), ``lat``, ``lon`` (rad) and ``height`` (m): a log's
            reference, say.
        smoothing: Time below which movement counts as noise, s.

    Returns:
        The motion, with the record's first position as its origin.

    Raises:
        LogError: A column is missing, a value is not finite, time does not increase, or there
            are fewer than ten positions.
    """
    t, lat, lon, height = _columns(table)
    east, north = _track(lat, lon, height)
    interval = float(np.median(np.diff(t)))
    smoothness = max(smoothing, 1.5 * interval) ** 4 / interval
    end = float(t[-1])
    knots = np.arange(0.0, end + KNOT_INTERVAL, KNOT_INTERVAL).clip(max=end)
    e, n = (make_smoothing_spline(t, x, lam=smoothness) for x in (east, north))
    v_e, v_n = e.derivative()(knots), n.derivative()(knots)
    speed = np.hypot(v_e, v_n)
    speed[speed < STANDING] = 0.0
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(knots)
    distance = np.concatenate(([0.0], np.cumsum(steps)))
    course = _course(distance, speed, v_e, v_n)
    along, slope = _slope(distance, np.interp(knots, t, height))
    return Motion(
        duration=end,
        speed=uniform_spline(
            lambda x: np.interp(x, knots, speed / np.cos(np.interp(distance, along, slope))),
            end,
            KNOT_INTERVAL,
        ),
        azimuth=uniform_spline(lambda x: np.interp(x, knots, course), end, KNOT_INTERVAL),
        slope=uniform_spline(
            lambda x: np.interp(x, along, slope), along[-1] + 500.0, KNOT_DISTANCE
        ),
        crossfall=uniform_spline(np.zeros_like, along[-1] + 500.0, KNOT_DISTANCE),
        origin=(float(lat[0]), float(lon[0]), float(height[0])),
        description=f"recorded trajectory of {end:g} s and {distance[-1]:.0f} m",
    )


def _columns(table: pd.DataFrame) -> tuple[Array, Array, Array, Array]:
    names = ("t", "lat", "lon", "height")
    missing = [name for name in names if name not in table]
    if missing:
        raise LogError(
            f"recorded trajectory: no column {', '.join(missing)}; expected {', '.join(names)}"
        )
    t, lat, lon, height = (table[name].to_numpy(dtype=np.float64) for name in names)
    if t.size < 10 or not np.isfinite(table[list(names)].to_numpy(dtype=np.float64)).all():
        raise LogError(
            f"recorded trajectory: found {t.size} rows; expected ten or more, all finite; drop "
            "the others"
        )
    if not (np.diff(t) > 0.0).all():
        row = int(np.argmax(np.diff(t) <= 0.0)) + 2
        raise LogError(f"recorded trajectory: time does not increase at row {row}; sort the rows")
    if np.abs(lat).max() > np.pi / 2.0 or np.abs(lon).max() > 2.0 * np.pi:
        raise LogError("recorded trajectory: lat or lon is not in radians; convert from degrees")
    return t - t[0], lat, lon, height


def _track(lat: Array, lon: Array, height: Array) -> tuple[Array, Array]:
    p, q, h = (torch.from_numpy(np.array(a)) for a in (lat, lon, height))
    # Step by step: a difference over the whole way would bend with the Earth.
    east, north, _ = enu_between(p[1:], q[1:], h[1:], p[:-1], q[:-1], h[:-1])
    start = np.zeros(1)
    return (
        np.concatenate((start, np.cumsum(east.numpy()))),
        np.concatenate((start, np.cumsum(north.numpy()))),
    )


def _course(distance: Array, speed: Array, v_e: Array, v_n: Array) -> Array:
    moving = speed > COURSE_SPEED
    if not moving.any():
        raise LogError("recorded trajectory: the car never moves; choose another record")
    known = np.unwrap(np.arctan2(v_e[moving], v_n[moving]))
    # Over distance, not time: a standing car does not turn.
    return np.interp(distance, distance[moving], known)


def _slope(distance: Array, height: Array) -> tuple[Array, Array]:
    way, first = np.unique(distance, return_index=True)
    along = np.arange(0.0, way[-1] + KNOT_DISTANCE, KNOT_DISTANCE)
    heights = np.interp(along, way, height[first])
    half = max(1, round(0.5 * SLOPE_WAY / KNOT_DISTANCE))
    padded = np.pad(heights, half + 1, mode="edge")
    smooth = np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
    return along, np.arctan((smooth[2:] - smooth[:-2]) / (2.0 * KNOT_DISTANCE))
