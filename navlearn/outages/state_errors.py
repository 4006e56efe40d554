"""Errors of every navigation state over a whole drive, and their RMS.

The states are those of [Ghouneem2024] Tables II and III, whose second "Longitude" is altitude:
azimuth, velocity east, north and up, and position as metres of latitude, longitude and altitude.
No outage is made. Every solution is judged at the reference's own times, all of them at the same
ones, some time after the last of them was aligned.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError, ShapeError
from navlearn.outages.bootstrap import resampled_sums, tail_probability
from navlearn.outages.metrics import wrap
from navlearn.outages.track import Array, enu_metres

STATES: Final[dict[str, str]] = {
    "azimuth": "°",
    "east velocity": "m/s",
    "north velocity": "m/s",
    "up velocity": "m/s",
    "latitude": "m",
    "longitude": "m",
    "altitude": "m",
}
"""What is judged, and its unit, in the order of the paper's tables."""

FIGURES: Final = {"median": 0.5, "95 %": 0.95, "largest": 1.0}
"""Quantiles of the horizontal error."""

VELOCITY_TIME: Final = "t_velocity"
"""Column of a solution with the times at which its velocities hold; ``t`` where it is missing."""

NEAR: Final = 0.06
"""A solution belongs to a time of the reference that lies this near, s."""


def state_errors(solution: pd.DataFrame, reference: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of a solution at the reference's times that it covers.

    Args:
        solution: Columns ``t`` (s), ``lat``, ``lon`` (rad), ``height`` (m) and, where they are
            known, ``azimuth`` (rad), ``v_e``, ``v_n``, ``v_u`` (m/s) and :data:`VELOCITY_TIME`.
            Between samples that lie apart nothing is judged but what is :data:`NEAR` to one.
        reference: The same columns; what is missing is not judged.

    Returns:
        ``t`` and a column per state of :data:`STATES` in its unit, estimate minus reference, NaN
        where either is unknown.

    Raises:
        ShapeError: The solution has fewer than two positions.
    """
    known = solution.dropna(subset=["lat", "lon"])
    if len(known) < 2:
        raise ShapeError(
            f"a solution over a whole drive has {len(known)} positions; expected two or more"
        )
    truth = reference.dropna(subset=["lat", "lon"])
    at, t = times_covered(known["t"].to_numpy(np.float64), truth["t"].to_numpy(np.float64))
    truth = truth.iloc[at]

    def found(name: str, times: str = "t") -> Array:
        if name not in known.columns:
            return np.full(t.shape, np.nan)
        own = known[times if times in known.columns else "t"].to_numpy(np.float64)
        values = known[name].to_numpy(np.float64)
        angle = name in ("lon", "azimuth")
        return np.asarray(np.interp(t, own, np.unwrap(values) if angle else values))

    def told(name: str) -> Array:
        if name not in truth.columns:
            return np.full(t.shape, np.nan)
        return np.asarray(truth[name], dtype=np.float64)

    place = [told(name) for name in ("lat", "lon", "height")]
    east, north, up = enu_metres(found("lat"), found("lon"), found("height"), *place)
    speeds = [found(name, VELOCITY_TIME) - told(name) for name in ("v_e", "v_n", "v_u")]
    azimuth = np.degrees(wrap(found("azimuth") - told("azimuth")))
    columns = [azimuth, *speeds, north, east, up]
    return pd.DataFrame({"t": t, **dict(zip(STATES, columns, strict=True))})


def times_covered(own: Array, asked: Array) -> tuple[np.ndarray, Array]:
    """Return the times of a reference at which a solution says something, and where it does so.

    Args:
        own: Times of the solution, s, increasing, shape (T,).
        asked: Times of the reference, s, shape (N,).

    Returns:
        Indices into ``asked``, shape (M,), and times at which to interpolate the solution, s,
        shape (M,): the reference's own, or that of the solution's nearest sample where its samples
        lie apart.
    """
    after = np.clip(np.searchsorted(own, asked), 1, len(own) - 1)
    dense = np.diff(own)[after - 1] <= 4.0 * NEAR
    nearest = np.where(asked - own[after - 1] < own[after] - asked, own[after - 1], own[after])
    inside = (asked >= own[0]) & (asked <= own[-1])
    at = np.flatnonzero(inside & (dense | (np.abs(nearest - asked) <= NEAR)))
    return at, np.where(dense, asked, nearest)[at]


def judged_together(
    errors: dict[str, pd.DataFrame], settle: float, not_before: float | None = None
) -> pd.DataFrame:
    """Return the errors of several solutions of a drive at the times that all of them have.

    Args:
        errors: What :func:`state_errors` returned, by name.
        settle: So long after the last of them begins nothing counts, s.
        not_before: Nor does anything before this time, s; None means no such time.

    Returns:
        The rows of all, with their name as ``solution``; by solution, then by time.
    """
    since = max(float(one["t"].iloc[0]) if len(one) else math.inf for one in errors.values())
    begin = max(since + settle, -math.inf if not_before is None else not_before)
    times = [set(one.loc[one["t"] >= begin, "t"]) for one in errors.values()]
    common = set.intersection(*times)
    parts = [one[one["t"].isin(common)].assign(solution=name) for name, one in errors.items()]
    return pd.concat(parts, ignore_index=True)


def state_rmse(
    errors: pd.DataFrame, baseline: str, *, resamples: int = 5000, seed: int = 0
) -> pd.DataFrame:
    """Return the RMS error of every state and solution, and its gain over a baseline.

    Args:
        errors: Rows of :func:`judged_together` of one or several drives, with a column ``drive``.
        baseline: Solution that gains are counted from.
        resamples: Draws of the bootstrap, which draws whole drives.
        seed: Of the draws.

    Returns:
        One row per state and solution: ``state``, ``unit``, ``solution``, ``rmse`` with its 95 %
        interval ``low`` and ``high``, ``gain_percent`` (by how much the RMS is smaller than the
        baseline's) with ``gain_low`` and ``gain_high``, ``drives`` and ``times``. Intervals are NaN
        with one drive.

    Raises:
        ConfigError: The baseline is not among the solutions.
    """
    names = list(dict.fromkeys(errors["solution"]))
    if baseline not in names:
        raise ConfigError(f"baseline {baseline!r} is not among the solutions: {', '.join(names)}")
    rows = []
    for state, unit in STATES.items():
        sums = [_sums(errors[errors["solution"] == name], state) for name in names]
        table = pd.concat(sums, axis=1, keys=names)
        draws = _root_of_draws(table, names, resamples, seed)
        roots = {name: _root(*(float(v) for v in table[name].sum())) for name in names}
        tail = 100.0 * tail_probability(len(table))
        for name in names:
            gains = 100.0 * (1.0 - draws[name] / draws[baseline])
            ends = [_ends(values, tail, len(table)) for values in (draws[name], gains)]
            rows.append(
                {
                    "state": state,
                    "unit": unit,
                    "solution": name,
                    "rmse": roots[name],
                    "low": ends[0][0],
                    "high": ends[0][1],
                    "gain_percent": _gain(roots[name], roots[baseline]),
                    "gain_low": ends[1][0],
                    "gain_high": ends[1][1],
                    "drives": len(table),
                    "times": int(table[name]["count"].sum()),
                }
            )
    return pd.DataFrame(rows)


def horizontal_figures(errors: pd.DataFrame) -> pd.DataFrame:
    """Return median, 95th percentile and largest of the horizontal error, m, by solution.

    Args:
        errors: As :func:`state_rmse` takes them.
    """
    off = pd.Series(np.hypot(errors["latitude"], errors["longitude"]), index=errors.index)
    by_solution = off.groupby(errors["solution"], sort=False)
    return pd.DataFrame({name: by_solution.quantile(q) for name, q in FIGURES.items()})


def _sums(errors: pd.DataFrame, state: str) -> pd.DataFrame:
    """Return sum of squares and count per drive."""
    square = errors[state] ** 2
    by_drive = square.groupby(errors["drive"], sort=True)
    return pd.DataFrame({"square": by_drive.sum(), "count": by_drive.count()})


def _root_of_draws(
    table: pd.DataFrame, names: Sequence[str], resamples: int, seed: int
) -> dict[str, Array]:
    """Return the RMS of each solution in every draw of drives, the same draws for all."""
    sums = resampled_sums(
        table.to_numpy(np.float64), np.arange(len(table)), resamples=resamples, seed=seed
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return {name: np.sqrt(sums[:, 2 * k] / sums[:, 2 * k + 1]) for k, name in enumerate(names)}


def _root(square: float, count: float) -> float:
    return math.sqrt(square / count) if count else math.nan


def _gain(ours: float, theirs: float) -> float:
    return 100.0 * (1.0 - ours / theirs) if theirs > 0.0 else math.nan


def _ends(values: Array, tail: float, drives: int) -> tuple[float, float]:
    if drives < 2 or not np.isfinite(values).all():
        return math.nan, math.nan
    low, high = np.percentile(values, [tail, 100.0 - tail])
    return float(low), float(high)
