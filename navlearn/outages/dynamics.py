"""What the car does through an outage, in one word, by stated thresholds."""

import numpy as np

from navlearn.outages.schedule import Outage
from navlearn.outages.track import Array, Track, driven, stood, turned

MOTORWAY_SPEED = 22.0
"""Mean speed from which a stretch is motorway, m/s."""

STANDSTILL_SPEED = 0.5
"""Below this speed the car stands, m/s."""

STANDSTILL_SHARE = 0.15
"""Share of the time standing from which a stretch is a stop."""

TURN_ANGLE = np.radians(60.0)
"""Angle turned from which a stretch is a turn, rad."""

HILL_SLOPE = 0.02
"""Span of heights over distance driven from which a stretch is a hill ..."""

HILL_SPAN = 8.0
"""... if the span of heights is also at least this, m."""


def classify_outage(track: Track, outage: Outage) -> str:
    """Return what the car does through an outage.

    The first that fits of: ``motorway``, ``stop``, ``turn``, ``hill``; else ``straight``. The
    thresholds are this module's constants.

    Args:
        track: The reference.
        outage: The outage.
    """
    return str(classify_windows(track, np.array([outage.start]), outage.duration)[0])


def classify_windows(track: Track, starts: Array, duration: float) -> np.ndarray:
    """Return what the car does through each of many windows.

    Args:
        track: The reference.
        starts: Starts of the windows, s, shape (K,).
        duration: Their length, s.

    Returns:
        One word of :data:`navlearn.outages.schedule.DYNAMICS` each, shape (K,).
    """
    distance = over_windows(track, driven(track), starts, duration)
    standing = over_windows(track, stood(track, STANDSTILL_SPEED), starts, duration)
    angle = over_windows(track, turned(track), starts, duration)
    span = _height_span(track, starts, duration)
    hilly = (span >= HILL_SPAN) & (span >= HILL_SLOPE * distance)
    return np.select(
        [
            distance >= MOTORWAY_SPEED * duration,
            standing >= STANDSTILL_SHARE * duration,
            angle >= TURN_ANGLE,
            hilly,
        ],
        ["motorway", "stop", "turn", "hill"],
        default="straight",
    )


def over_windows(track: Track, running_total: Array, starts: Array, duration: float) -> Array:
    """Return how much of a running total falls into each window.

    Args:
        track: The track whose times the total has.
        running_total: Total since the start of the track, shape (T,).
        starts: Starts of the windows, s, shape (K,).
        duration: Their length, s.

    Returns:
        Increase through each window, shape (K,).
    """
    at_end = np.interp(starts + duration, track.t, running_total)
    return np.asarray(at_end - np.interp(starts, track.t, running_total), dtype=np.float64)


def _height_span(track: Track, starts: Array, duration: float) -> Array:
    known = np.isfinite(track.height)
    t, height = track.t[known], track.height[known]
    first = np.searchsorted(t, starts, side="left")
    last = np.searchsorted(t, starts + duration, side="right")
    return np.array(
        [np.ptp(height[a:b]) if b > a else 0.0 for a, b in zip(first, last, strict=True)]
    )
