"""Where GNSS is too sparse and where the reference is too bad to score."""

import numpy as np
from numpy.typing import NDArray

from navlearn.outages.schedule import Exclusion
from navlearn.outages.track import Array, Track, enu_metres

Interval = tuple[float, float]


def gaps(t: Array, limit: float) -> list[Interval]:
    """Return the intervals between successive times that are longer than a limit.

    Args:
        t: Times, s, increasing, shape (T,).
        limit: Longest interval that is not a gap, s.
    """
    wide = np.flatnonzero(np.diff(t) > limit)
    return [(float(t[k]), float(t[k + 1])) for k in wide]


def within_any(starts: Array, ends: Array, intervals: list[Interval]) -> NDArray[np.bool_]:
    """Return which windows share time with any of some intervals.

    Args:
        starts: Starts of the windows, s, shape (K,).
        ends: Their ends, s, shape (K,).
        intervals: Starts and ends, s.

    Returns:
        Shape (K,).
    """
    shared = np.zeros(starts.shape, dtype=np.bool_)
    for first, last in intervals:
        shared |= (starts < last) & (ends > first)
    return shared


def bad_reference(
    track: Track, max_interval: float, max_slip: float, span: float
) -> list[Exclusion]:
    """Return where a reference is bad: holes, and positions that belie their own velocity.

    Args:
        track: The reference.
        max_interval: Longest time between positions, s.
        max_slip: Largest difference between a change of position and the integral of the
            velocity, m.
        span: Time over which they are compared, s.

    Returns:
        Bad stretches in order of time; slips that touch are one stretch.
    """
    holes = [
        Exclusion(first, last, f"no {track.origin} for {last - first:.1f} s")
        for first, last in gaps(track.t, max_interval)
    ]
    return sorted([*holes, *_slips(track, max_slip, span)], key=lambda bad: bad.start)


def slip(track: Track, span: float) -> Array:
    """Return by how much positions move other than their own velocity says.

    Args:
        track: The reference.
        span: Time over which both are summed, s.

    Returns:
        Difference over the span that ends at each position, m, shape (T,); NaN where the
        velocity is unknown or the span reaches before the track.
    """
    east, north, _ = enu_metres(
        track.lat[1:],
        track.lon[1:],
        track.height[1:],
        track.lat[:-1],
        track.lon[:-1],
        track.height[:-1],
    )
    dt = np.diff(track.t)
    excess_e = east - 0.5 * (track.v_e[1:] + track.v_e[:-1]) * dt
    excess_n = north - 0.5 * (track.v_n[1:] + track.v_n[:-1]) * dt
    first = np.searchsorted(track.t, track.t - span, side="left")
    unknown = np.concatenate(([0], np.cumsum(~np.isfinite(excess_e + excess_n))))
    total_e = np.concatenate(([0.0], np.cumsum(np.nan_to_num(excess_e))))
    total_n = np.concatenate(([0.0], np.cumsum(np.nan_to_num(excess_n))))
    out = np.hypot(total_e - total_e[first], total_n - total_n[first])
    usable = (unknown == unknown[first]) & (track.t - span >= track.t[0])
    return np.where(usable, out, np.nan)


def _slips(track: Track, limit: float, span: float) -> list[Exclusion]:
    found = slip(track, span)
    bad = np.flatnonzero(np.nan_to_num(found) > limit)
    if bad.size == 0:
        return []
    apart = np.flatnonzero(np.diff(track.t[bad]) > span) + 1
    stretches = []
    for group in np.split(bad, apart):
        worst = float(found[group].max())
        reason = (
            f"{track.origin} slides {worst:.1f} m against its own velocity within {span:g} s "
            f"(limit {limit:g} m)"
        )
        first = max(float(track.t[group[0]]) - span, float(track.t[0]))
        stretches.append(Exclusion(first, float(track.t[group[-1]]), reason))
    return stretches
