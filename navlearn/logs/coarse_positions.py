"""Where a receiver is, to a few hundred metres: enough to look up at its satellites.

Found from fixes or from the ranges themselves, always from what came before.
"""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import torch
from torch import Tensor

from navlearn.gnss.single_point import Reason, SinglePoint, single_point
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.logs.interval_means import FloatArray
from navlearn.states import SatelliteRanges

IntArray = npt.NDArray[np.int64]

EVERY: Final = 10.0
"""Ranges are solved anew this often, s: a car gets no further than satellites notice."""

_FARTHEST_OFF: Final = 500.0
"""Delays and streets leave no larger residual; what does is a range that is wrong, m."""


class Coarse(NamedTuple):
    """Coarse positions and when they became known, shape (K,) each.

    Attributes:
        t: Time, s, increasing.
        lat: Latitude, rad.
        lon: Longitude, rad.
        height: Height above the ellipsoid, m.
    """

    t: FloatArray
    lat: FloatArray
    lon: FloatArray
    height: FloatArray


def coarse_from_fixes(fixes: pd.DataFrame) -> Coarse:
    """Return the positions of fixes; an unknown height is the last one known, or zero.

    Args:
        fixes: Columns ``t``, ``lat``, ``lon`` and perhaps ``height``.
    """
    found = fixes[fixes["lat"].notna() & fixes["lon"].notna()]
    height = found["height"].ffill().fillna(0.0) if "height" in found else 0.0 * found["lat"]
    columns = (found["t"], found["lat"], found["lon"], height)
    return Coarse(*(column.to_numpy(np.float64) for column in columns))


def coarse_from_ranges(
    t: FloatArray, satellite: Tensor, pseudorange: Tensor, has: Tensor, system: Tensor
) -> Coarse:
    """Return single-point positions, one in every so many seconds.

    Args:
        t: Times of reception, s, increasing, shape (M,).
        satellite: Satellites in axes of reception, m, shape (M, S, 3).
        pseudorange: Pseudoranges free of the satellites' clocks, m, shape (M, S).
        has: 1.0 where there is one, shape (M, S).
        system: Whose time each satellite keeps, int64, shape (S,).
    """
    chosen = _enough(t, has, system) if has.numel() else np.zeros(0, dtype=np.int64)
    if chosen.size == 0:
        return Coarse(*(np.zeros(0) for _ in Coarse._fields))
    kept = torch.from_numpy(chosen)
    ranges = _seen_anyhow(satellite[kept], pseudorange[kept], has[kept], system)
    with torch.no_grad():
        found = single_point(ranges, SinglePointOptions(elevation_mask=0.0))
    believed = (found.ok | _nearly_consistent(found)).numpy()
    return Coarse(
        t[chosen][believed],
        *(part.numpy()[believed] for part in (found.lat, found.lon, found.height)),
    )


def _nearly_consistent(found: SinglePoint) -> Tensor:
    # delays are still in the ranges: that they do not fit to metres says nothing here
    off = (found.used * found.residual).abs().amax(-1)
    low, high = SinglePointOptions().heights
    near: Tensor = (found.reason == Reason.INCONSISTENT) & (off < _FARTHEST_OFF)
    return near & (found.height > low) & (found.height < high)


def latest(coarse: Coarse, t: FloatArray) -> tuple[FloatArray, Coarse]:
    """Return 1.0 where a position was known by then, and that position (else zeros), at times.

    Args:
        coarse: What became known when.
        t: Times asked, s, shape (M,).
    """
    if coarse.t.size == 0:
        return np.zeros(t.size), Coarse(t, *(np.zeros(t.size) for _ in range(3)))
    place = np.searchsorted(coarse.t, t + 1e-9, side="right") - 1
    known = (place >= 0).astype(np.float64)
    held = np.maximum(place, 0)
    # before the first position there is none, not the one that follows
    return known, Coarse(t, *(known * part[held] for part in coarse[1:]))


def _enough(t: FloatArray, has: Tensor, system: Tensor) -> IntArray:
    """Return the first reception of each stretch of time that can be solved."""
    heard = has.numpy() > 0.0
    clocks = [heard[:, system.numpy() == k].any(axis=1) for k in range(int(system.max()) + 1)]
    solvable = np.flatnonzero(heard.sum(axis=1) >= 3 + np.sum(clocks, axis=0))
    stretch = np.floor(t[solvable] / EVERY)
    first = np.concatenate(([True], np.diff(stretch) > 0.0))[: solvable.size]
    found: IntArray = solvable[first]
    return found


def _seen_anyhow(
    satellite: Tensor, pseudorange: Tensor, has: Tensor, system: Tensor
) -> SatelliteRanges:
    """Return ranges of which only satellites, pseudoranges and systems are known."""
    unknown = torch.zeros_like(pseudorange)
    return SatelliteRanges(
        satellite=satellite,
        satellite_velocity=torch.zeros_like(satellite),
        pseudorange=pseudorange,
        range_rate=unknown,
        elevation=unknown + 0.25 * math.pi,
        cn0=unknown + 45.0,
        std_range=unknown,
        std_rate=unknown,
        system=system,
        has_range=has,
        has_rate=unknown,
    )
