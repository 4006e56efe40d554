"""Where a receiver is, to a few hundred metres: enough to look up at its satellites.

Found from fixes or from the ranges themselves, always from what came before.
"""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import torch
from torch import Tensor

from navlearn import frames
from navlearn.logs.interval_means import FloatArray

IntArray = npt.NDArray[np.int64]

EVERY: Final = 10.0
"""Ranges are solved anew this often, s: a car gets no further than satellites notice."""

HUBER: Final = 30.0
"""Residual from which a range counts less and less, m."""

LOWEST, HIGHEST = -1000.0, 20000.0
"""Heights of receivers that are believed, m."""

LARGEST_DILUTION: Final = 30.0
"""Geometries worse than this say nothing."""


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
    """Return positions by robust least squares from every so many ranges.

    Gauss-Newton from the Earth's centre, then reweighted after Huber; one clock per system.

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
    position, fine = _solved(satellite[kept], pseudorange[kept], has[kept], system)
    lat, lon, height = frames.geodetic_from_ecef(position)
    fine = fine & (height > LOWEST) & (height < HIGHEST)
    believed = fine.numpy()
    return Coarse(t[chosen][believed], *(part.numpy()[believed] for part in (lat, lon, height)))


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


def _solved(
    satellite: Tensor, pseudorange: Tensor, has: Tensor, system: Tensor
) -> tuple[Tensor, Tensor]:
    """Return Earth-fixed positions, shape (M, 3), and which of them are well determined."""
    clocks = torch.nn.functional.one_hot(system).to(pseudorange)
    clocks = clocks.expand(*pseudorange.shape, clocks.shape[-1])
    unknown = pseudorange.new_zeros(pseudorange.shape[0], 3 + clocks.shape[-1])
    ridge = 1e-9 * torch.eye(unknown.shape[-1], dtype=unknown.dtype)
    weight, normal = has, ridge.expand(len(unknown), -1, -1)
    for turn in range(16):
        away = satellite - unknown[:, None, :3]
        distance = torch.linalg.vector_norm(away, dim=-1).clamp_min(1.0)
        design = torch.cat((-away / distance.unsqueeze(-1), clocks), dim=-1)
        offset = (clocks * unknown[:, None, 3:]).sum(-1)
        residual = torch.where(has > 0.0, pseudorange - distance - offset, 0.0 * distance)
        if turn >= 8:
            weight = has * HUBER / residual.abs().clamp_min(HUBER)
        weighted = design * weight.unsqueeze(-1)
        normal = design.transpose(-1, -2) @ weighted + ridge
        unknown = unknown + torch.linalg.solve(normal, (weighted * residual.unsqueeze(-1)).sum(-2))
    spread = torch.linalg.inv(normal).diagonal(dim1=-2, dim2=-1)[:, :3].sum(-1)
    fine = torch.isfinite(unknown).all(-1) & (spread < LARGEST_DILUTION**2) & (spread > 0.0)
    return unknown[:, :3], fine
