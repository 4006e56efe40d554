"""The track that outages are placed on and judged by.

A log's reference where it has one; else its own fixes, which only placement and scoring ever
see inside an outage.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from navlearn import frames
from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog

Array = NDArray[np.float64]

COURSE_SPEED = 3.0
"""Below this speed (m/s) the direction of a GNSS velocity says little about the azimuth."""

TURN_STEP = 5.0
"""Turned angle is summed over steps of this many seconds, so that noise does not count."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """Positions of the car by which outages are placed and judged, shape (T,) each.

    Attributes:
        t: Time, s, strictly increasing.
        lat: Latitude, rad, finite.
        lon: Longitude, rad, finite.
        height: Height, m; NaN where unknown.
        v_e: Velocity to the east, m/s; NaN where unknown.
        v_n: Velocity to the north, m/s; NaN where unknown.
        azimuth: Azimuth, rad, not wrapped; NaN where unknown.
        azimuth_source: ``azimuth`` (measured), ``course`` (direction of velocity above
            :data:`COURSE_SPEED`) or ``none``.
        origin: ``reference``, ``truth`` or ``fixes``: what the track was made of.
    """

    t: Array
    lat: Array
    lon: Array
    height: Array
    v_e: Array
    v_n: Array
    azimuth: Array
    azimuth_source: str
    origin: str

    def between(self, start: float, end: float) -> "Track":
        """Return the part from one time to another, both included.

        Args:
            start: First time, s.
            end: Last time, s.
        """
        keep = (self.t >= start) & (self.t <= end)
        return Track(
            t=self.t[keep],
            lat=self.lat[keep],
            lon=self.lon[keep],
            height=self.height[keep],
            v_e=self.v_e[keep],
            v_n=self.v_n[keep],
            azimuth=self.azimuth[keep],
            azimuth_source=self.azimuth_source,
            origin=self.origin,
        )

    @property
    def speed(self) -> Array:
        """Horizontal speed, m/s, shape (T,); from positions where velocity is unknown."""
        known = np.hypot(self.v_e, self.v_n)
        if np.isfinite(known).all() or self.t.size < 2:
            return known
        east, north, _ = local_metres(self, self.lat[0], self.lon[0])
        derived = np.hypot(np.gradient(east, self.t), np.gradient(north, self.t))
        return np.where(np.isfinite(known), known, derived)


def track_of(log: DriveLog) -> Track:
    """Return the track of a log: its reference, else its own fixes.

    Where the fixes serve, they count at the time at which they were valid, not at their stamp,
    and errors are those against the position of the antenna.

    Args:
        log: A drive.

    Raises:
        LogError: There are fewer than two positions to go by.
    """
    if log.reference is not None:
        table, origin = log.reference, "truth" if log.metadata.is_truth else "reference"
    else:
        late = 0.0 if log.metadata.latency_removed else log.metadata.gnss_latency
        table, origin = log.fixes.assign(t=log.fixes["t"] - late), "fixes"
    return track_from_table(table, origin, where=log.metadata.name)


def track_from_table(table: pd.DataFrame, origin: str, *, where: str = "log") -> Track:
    """Return the track of a reference or fix table; rows without a position are left out.

    Args:
        table: A table with the columns of ``reference`` or ``fixes``.
        origin: What the table is, for reports.
        where: Name of the log, for messages.

    Raises:
        LogError: There are fewer than two positions to go by.
    """
    position = table[["t", "lat", "lon"]].to_numpy(dtype=np.float64)
    keep = np.isfinite(position).all(axis=1)
    if keep.sum() < 2:
        raise LogError(
            f"{where}: its {origin} table has {int(keep.sum())} usable positions; outages need "
            "positions to be placed and judged by: give the log a reference or GNSS fixes"
        )

    def column(name: str) -> Array:
        if name not in table.columns:
            return np.full(int(keep.sum()), np.nan)
        values = np.asarray(table[name], dtype=np.float64)
        return np.asarray(values[keep], dtype=np.float64)

    v_e, v_n = column("v_e"), column("v_n")
    azimuth, source = _azimuth(column("azimuth"), v_e, v_n)
    return Track(
        t=position[keep, 0],
        lat=position[keep, 1],
        lon=position[keep, 2],
        height=column("height"),
        v_e=v_e,
        v_n=v_n,
        azimuth=azimuth,
        azimuth_source=source,
        origin=origin,
    )


def local_metres(
    track: Track, lat_0: Array | float, lon_0: Array | float, height_0: Array | float = 0.0
) -> tuple[Array, Array, Array]:
    """Return east, north and up of a track's positions against an origin.

    Args:
        track: The positions.
        lat_0: Latitude of the origin, rad, shape () or (T,).
        lon_0: Longitude of the origin, rad, shape () or (T,).
        height_0: Height of the origin, m, shape () or (T,).

    Returns:
        East, north, up, m, shape (T,) each; up is NaN where a height is unknown.
    """
    return enu_metres(track.lat, track.lon, track.height, lat_0, lon_0, height_0)


def enu_metres(
    lat: Array,
    lon: Array,
    height: Array,
    lat_0: Array | float,
    lon_0: Array | float,
    height_0: Array | float,
) -> tuple[Array, Array, Array]:
    """Return :func:`navlearn.frames.enu_between` of arrays; unknown heights spoil only up.

    Args:
        lat: Latitude, rad, shape (T,).
        lon: Longitude, rad, shape (T,).
        height: Height, m, shape (T,), NaN where unknown.
        lat_0: Latitude of the origin, rad, shape () or (T,).
        lon_0: Longitude of the origin, rad, shape () or (T,).
        height_0: Height of the origin, m, shape () or (T,), NaN where unknown.

    Returns:
        East, north, up, m, shape (T,) each.
    """
    up = np.asarray(height - height_0, dtype=np.float64)
    known = [np.nan_to_num(np.asarray(h, dtype=np.float64)) for h in (height, height_0)]
    values = (lat, lon, known[0], lat_0, lon_0, known[1])
    tensors = [torch.tensor(np.asarray(v), dtype=torch.float64) for v in values]
    east, north, _ = frames.enu_between(*tensors)
    return east.numpy(), north.numpy(), up


def driven(track: Track) -> Array:
    """Return the distance driven since the first position, m, shape (T,).

    Speed integrated by trapezia, so that the noise of a parked receiver does not add up.

    Args:
        track: The positions.
    """
    return _integral(track.t, track.speed)


def turned(track: Track) -> Array:
    """Return the angle turned since the first position, rad, never decreasing, shape (T,).

    Sum of the absolute changes of azimuth over steps of :data:`TURN_STEP` seconds.

    Args:
        track: The positions.
    """
    known = np.isfinite(track.azimuth)
    if known.sum() < 2:
        return np.full(track.t.size, np.nan if track.azimuth_source == "none" else 0.0)
    knots = np.arange(track.t[0], track.t[-1] + TURN_STEP, TURN_STEP)
    knots[-1] = track.t[-1]
    at_knots = np.interp(knots, track.t[known], track.azimuth[known])
    total = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(at_knots)))))
    return np.asarray(np.interp(track.t, knots, total), dtype=np.float64)


def stood(track: Track, slower_than: float) -> Array:
    """Return the seconds spent below a speed since the first position, shape (T,).

    Args:
        track: The positions.
        slower_than: Speed, m/s.
    """
    return _integral(track.t, (track.speed < slower_than).astype(np.float64))


def _integral(t: Array, values: Array) -> Array:
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.zeros(t.size)
    filled = np.interp(t, t[known], values[known])
    steps = 0.5 * (filled[1:] + filled[:-1]) * np.diff(t)
    return np.concatenate(([0.0], np.cumsum(steps)))


def _azimuth(measured: Array, v_e: Array, v_n: Array) -> tuple[Array, str]:
    if np.isfinite(measured).any():
        return _unwrapped(measured), "azimuth"
    course = np.where(np.hypot(v_e, v_n) >= COURSE_SPEED, np.arctan2(v_e, v_n), np.nan)
    if np.isfinite(course).any():
        return _unwrapped(course), "course"
    return measured, "none"


def _unwrapped(angle: Array) -> Array:
    out = angle.copy()
    known = np.isfinite(angle)
    out[known] = np.unwrap(angle[known])
    return out
