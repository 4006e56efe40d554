"""The fixes of a drive as tensors, placed on a grid of intervals."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
import torch

from navlearn.logs.interval_means import FloatArray
from navlearn.states import FixTiming, GnssFix

BoolArray = npt.NDArray[np.bool_]
Fixes = tuple[GnssFix, FixTiming, torch.Tensor]


@dataclass(frozen=True, kw_only=True)
class FixOptions:
    """What is assumed where a fix does not tell its own standard deviations.

    Attributes:
        std_horizontal: Standard deviation of position east and north, m.
        std_vertical: Standard deviation of height, m.
        std_velocity: Standard deviation of each velocity component, m/s.
        least_std_position: Smallest standard deviation of position believed, m.
        least_std_velocity: Smallest standard deviation of velocity believed, m/s.
    """

    std_horizontal: float = 2.0
    std_vertical: float = 4.0
    std_velocity: float = 0.1
    least_std_position: float = 0.05
    least_std_velocity: float = 0.02


def fixes_from_table(table: pd.DataFrame, edges: FloatArray, options: FixOptions) -> Fixes:
    """Return the fixes that fall on a grid, where they fall, and when they were valid.

    A fix is used at the nearest end of an interval. Fixes before the grid, or more than half an
    interval after it, are left out. A fix without horizontal velocity has ``has_velocity`` 0,
    without latitude or longitude ``has_position`` 0; a missing height or v_u is held at the
    last one known and given a very large standard deviation where it is a height.

    Args:
        table: Columns of :data:`navlearn.logs.columns.FIXES`.
        edges: Ends of the intervals of a uniform grid, s, shape (T+1,).
        options: Assumed standard deviations.

    Returns:
        Fixes, timing and times of validity, shape (M,) each.
    """
    t = table["t"].to_numpy(np.float64)
    kept, timing = placed_on_grid(t, edges)
    return _fix(table[kept], options), timing, torch.tensor(t[kept])


def placed_on_grid(t: FloatArray, edges: FloatArray) -> tuple[BoolArray, FixTiming]:
    """Return which moments fall on a grid, and the end of an interval nearest to each of those.

    Args:
        t: Moments, s, increasing, shape (M,).
        edges: Ends of the intervals of a uniform grid, s, shape (T+1,).

    Returns:
        Which are neither before the grid nor more than half an interval after it, shape (M,), and
        where those fall.
    """
    step = float(edges[1] - edges[0])
    kept = (t >= edges[0] - 1e-6 * step) & (t <= edges[-1] + 0.5 * step)
    index = np.clip(np.rint((t[kept] - edges[0]) / step).astype(np.int64) - 1, 0, edges.size - 2)
    return kept, FixTiming(torch.from_numpy(index), torch.from_numpy(edges[index + 1] - t[kept]))


def _fix(table: pd.DataFrame, options: FixOptions) -> GnssFix:
    def column(name: str) -> FloatArray:
        if name not in table:
            return np.full(len(table), np.nan)
        return table[name].to_numpy(np.float64)

    def filled(name: str, default: float) -> FloatArray:
        return np.nan_to_num(column(name), nan=default)

    lat, lon, v_e, v_n = column("lat"), column("lon"), column("v_e"), column("v_n")
    has_position = np.isfinite(lat) & np.isfinite(lon)
    has_velocity = np.isfinite(v_e) & np.isfinite(v_n)
    least, least_v = options.least_std_position, options.least_std_velocity
    channels = (
        _held(lat),
        _held(lon),
        _held(column("height")),
        np.where(has_velocity, v_e, 0.0),
        np.where(has_velocity, v_n, 0.0),
        filled("v_u", 0.0),
        np.maximum(filled("std_e", options.std_horizontal), least),
        np.maximum(filled("std_n", options.std_horizontal), least),
        np.maximum(_std_height(column("height"), filled("std_u", options.std_vertical)), least),
        np.maximum(filled("std_v", options.std_velocity), least_v),
        has_position.astype(np.float64),
        has_velocity.astype(np.float64),
    )
    return GnssFix(*(torch.tensor(channel) for channel in channels))


def _held(values: FloatArray) -> FloatArray:
    held = pd.Series(values).ffill().fillna(0.0)
    return np.asarray(held, dtype=np.float64)


def _std_height(height: FloatArray, std: FloatArray) -> FloatArray:
    # A height that was never measured must not pull the filter: 1 km says "unknown".
    return np.where(np.isfinite(height), std, np.float64(1000.0))
