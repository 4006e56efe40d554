"""The reference of a drive at any time, and what stands in where there is none.

Positions between reference samples follow the cubic that has the samples' velocities (Hermite):
a car that brakes between 1 Hz samples leaves the straight line by a quarter of a metre.
"""

from typing import Final

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from navlearn import earth
from navlearn.errors import LogError
from navlearn.logs.columns import REFERENCE
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.interval_means import FloatArray

_CIRCULAR: Final = ("azimuth", "pitch", "roll")


def reference_at(log: DriveLog, t: Tensor | FloatArray, *, max_gap: float = 2.5) -> pd.DataFrame:
    """Return the reference of a drive at given times.

    Args:
        log: Drive with a reference.
        t: Times, s, shape (K,).
        max_gap: Longest gap between reference samples that is bridged, s.

    Returns:
        Columns of :data:`navlearn.logs.columns.REFERENCE` that the log has, and ``t``; azimuth
        in [0, 2π); NaN outside the reference, in its longer gaps and where its values are NaN.

    Raises:
        LogError: The log has no reference.
    """
    if log.reference is None or log.reference.empty:
        raise LogError(
            f"{log.metadata.name}: the log has no reference to judge with; "
            "reference_from_fixes(log) gives the fixes themselves"
        )
    table = log.reference
    known = table["t"].to_numpy(np.float64)
    at = t.detach().cpu().numpy() if isinstance(t, Tensor) else np.asarray(t, dtype=np.float64)
    left, fraction, inside = _places(known, at, max_gap)
    values = {"t": at}
    for name in (column for column in REFERENCE if column in table):
        samples = table[name].to_numpy(np.float64)
        slopes = _slopes(table, name)
        if name in _CIRCULAR:
            found = _circular(samples, left, fraction)
        elif slopes is None:
            found = _linear(samples, left, fraction)
        else:
            found = _hermite(known, samples, slopes, left, fraction)
        values[name] = np.where(inside, found, np.nan)
    if "azimuth" in values:
        values["azimuth"] = np.mod(values["azimuth"], 2.0 * np.pi)
    return pd.DataFrame(values)


def reference_from_fixes(log: DriveLog, *, min_speed: float = 3.0) -> pd.DataFrame:
    """Return the fixes of a drive as its reference, where there is nothing better.

    Judging with it asks how well withheld fixes are foretold: its noise is the receiver's, it
    is the antenna's track, and its azimuth is the course, which is the forward axis only while
    the car does not slip and does not reverse.

    Args:
        log: Drive with GNSS velocity.
        min_speed: Below this speed a course says nothing and azimuth is NaN, m/s.

    Returns:
        Columns of :data:`navlearn.logs.columns.REFERENCE` that fixes can give.

    Raises:
        LogError: The drive has no fixes.
    """
    fixes = log.fixes[log.fixes["lat"].notna() & log.fixes["lon"].notna()].reset_index(drop=True)
    if fixes.empty:
        remedy = "make them of its raw ranges first (with_single_point_fixes)"
        raise LogError(
            f"{log.metadata.name}: neither a reference nor fixes to judge with; "
            + (remedy if log.ranges is not None else "use a log with one of them")
        )
    kept = ["t", *(name for name in REFERENCE if name in fixes)]
    table = fixes[kept].copy()
    if {"v_e", "v_n"} <= set(fixes):
        v_e, v_n = fixes["v_e"].to_numpy(np.float64), fixes["v_n"].to_numpy(np.float64)
        course = np.mod(np.arctan2(v_e, v_n), 2.0 * np.pi)
        table["azimuth"] = np.where(np.hypot(v_e, v_n) >= min_speed, course, np.nan)
    return table


def _places(
    known: FloatArray, at: FloatArray, max_gap: float
) -> tuple[np.ndarray, FloatArray, np.ndarray]:
    last = known.size - 1
    left = np.clip(np.searchsorted(known, at, side="right") - 1, 0, max(last - 1, 0))
    right = np.minimum(left + 1, last)
    step = known[right] - known[left]
    fraction = np.where(step > 0.0, (at - known[left]) / np.where(step > 0.0, step, 1.0), 0.0)
    within = (at >= known[0] - 1e-9) & (at <= known[-1] + 1e-9)
    on_sample = (np.abs(fraction) < 1e-9) | (np.abs(fraction - 1.0) < 1e-9)
    return left, np.clip(fraction, 0.0, 1.0), within & ((step <= max_gap) | on_sample)


def _slopes(table: pd.DataFrame, name: str) -> FloatArray | None:
    velocity = {"lat": "v_n", "lon": "v_e", "height": "v_u"}.get(name)
    if velocity is None or velocity not in table:
        return None
    speed = table[velocity].to_numpy(np.float64)
    if name == "height":
        return speed
    lat = torch.tensor(table["lat"].to_numpy(np.float64))
    height = torch.tensor(
        table["height"].fillna(0.0).to_numpy(np.float64) if "height" in table else 0.0
    )
    radius = earth.meridian_radius(lat) + height
    if name == "lon":
        radius = (earth.prime_vertical_radius(lat) + height) * torch.cos(lat)
    slopes: FloatArray = speed / radius.numpy()
    return slopes


def _pair(samples: FloatArray, left: np.ndarray) -> tuple[FloatArray, FloatArray]:
    return samples[left], samples[np.minimum(left + 1, samples.size - 1)]


def _blend(first: FloatArray, change: FloatArray, fraction: FloatArray) -> FloatArray:
    # At a sample itself its neighbour may be NaN without harm.
    return first + np.where(fraction == 0.0, 0.0, fraction * change)


def _linear(samples: FloatArray, left: np.ndarray, fraction: FloatArray) -> FloatArray:
    first, second = _pair(samples, left)
    found = _blend(first, second - first, fraction)
    return np.where(fraction == 1.0, second, found)


def _circular(samples: FloatArray, left: np.ndarray, fraction: FloatArray) -> FloatArray:
    first, second = _pair(samples, left)
    change = np.mod(second - first + np.pi, 2.0 * np.pi) - np.pi
    found = _blend(first, change, fraction)
    return np.where(fraction == 1.0, second, found)


def _hermite(
    known: FloatArray,
    samples: FloatArray,
    slopes: FloatArray,
    left: np.ndarray,
    fraction: FloatArray,
) -> FloatArray:
    first, second = _pair(samples, left)
    begin, end = _pair(slopes, left)
    step = np.diff(known, append=known[-1])[left]
    change, s = second - first, fraction
    shape = s * s * (3.0 - 2.0 * s)
    cubic = first + change * shape + step * s * (1.0 - s) * ((1.0 - s) * begin - s * end)
    straight = _linear(samples, left, fraction)
    return np.where(np.isfinite(cubic), cubic, straight)
