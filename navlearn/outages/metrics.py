"""How far a solution is off through one outage: errors over time, and their figures.

Error is estimate minus reference. The solution is interpolated at the reference's times; the
reference itself is never interpolated.
"""

import math
from collections.abc import Callable

import numpy as np
import pandas as pd

from navlearn.errors import FilterDivergedError, LogError, ShapeError
from navlearn.outages.schedule import Outage
from navlearn.outages.track import Array, Track, driven, enu_metres, turned

REQUIRED = ("t", "lat", "lon", "height", "v_e", "v_n", "azimuth")
"""Columns of a solution table; units and signs are those of a reference table."""

COVARIANCE = ("std_e", "std_n", "cov_en")
"""Optional columns: standard deviations (m) and covariance (m²) of the horizontal position."""

ELLIPSE_95 = -2.0 * math.log(0.05)
"""The 95 % quantile of χ² with two degrees of freedom."""

SLACK = 1.0
"""A solution may begin this late and end this early against its outage, s."""


FIGURES = (
    "distance_m",
    "turned_deg",
    "max_horizontal_error_m",
    "rms_horizontal_error_m",
    "final_horizontal_error_m",
    "max_azimuth_error_deg",
    "rms_azimuth_error_deg",
    "final_azimuth_error_deg",
    "max_height_error_m",
    "rms_height_error_m",
    "final_height_error_m",
    "max_velocity_error_m_per_s",
    "rms_velocity_error_m_per_s",
    "final_velocity_error_m_per_s",
    "max_horizontal_error_percent",
    "final_horizontal_error_percent",
    "rms_along_track_error_m",
    "rms_cross_track_error_m",
    "final_along_track_error_m",
    "final_cross_track_error_m",
    "first_horizontal_error_m",
    "share_in_95_ellipse",
    "final_in_95_ellipse",
    "reference_samples",
)
"""Names of the figures of an outage, in the order of ``outages.csv``. Along- and cross-track
final errors keep their sign (ahead, to the right); percents are of the distance driven."""


def errors_over_time(solution: pd.DataFrame, track: Track, outage: Outage) -> pd.DataFrame:
    """Return the errors of a solution at the reference's times within an outage.

    Args:
        solution: Table with the columns :data:`REQUIRED` and perhaps :data:`COVARIANCE`.
        track: The reference, of the whole drive.
        outage: The outage.

    Returns:
        One row per reference time: ``t``, ``since_start`` (s), ``east``, ``north``, ``up``,
        ``horizontal``, ``along``, ``cross`` (m; cross positive to the right), ``azimuth`` (rad),
        ``velocity`` (m/s), ``in_ellipse`` (1, 0); NaN where not known.

    Raises:
        ShapeError: A column is missing or times do not increase.
        FilterDivergedError: A position is not finite.
        LogError: The solution or the reference does not cover the outage.
    """
    check_solution(solution, outage)
    t = solution["t"].to_numpy(dtype=np.float64)
    truth = track.between(max(outage.start, t[0]), min(outage.end, t[-1]))
    if truth.t.size == 0:
        raise LogError(
            f"outage at {outage.start:g} s: the {track.origin} has no position in it; place the "
            "outage where it has"
        )

    def at(name: str) -> Array:
        values = np.asarray(solution[name], dtype=np.float64)
        return np.asarray(np.interp(truth.t, t, values), dtype=np.float64)

    lon = np.interp(truth.t, t, np.unwrap(solution["lon"].to_numpy(dtype=np.float64)))
    east, north, up = enu_metres(at("lat"), lon, at("height"), truth.lat, truth.lon, truth.height)
    azimuth = np.interp(truth.t, t, np.unwrap(solution["azimuth"].to_numpy(dtype=np.float64)))
    along, cross = _along_and_cross(east, north, direction_of_travel(truth))
    return pd.DataFrame(
        {
            "t": truth.t,
            "since_start": truth.t - outage.start,
            "east": east,
            "north": north,
            "up": up,
            "horizontal": np.hypot(east, north),
            "along": along,
            "cross": cross,
            "azimuth": wrap(azimuth - truth.azimuth),
            "velocity": np.hypot(at("v_e") - truth.v_e, at("v_n") - truth.v_n),
            "in_ellipse": _in_ellipse(solution, at, east, north),
        }
    )


def figures(errors: pd.DataFrame, track: Track, outage: Outage) -> dict[str, float]:
    """Return the figures of one outage, by the names of their columns in ``outages.csv``.

    Args:
        errors: What :func:`errors_over_time` returned.
        track: The reference, of the whole drive.
        outage: The outage.

    Returns:
        Figures with their unit in their name; NaN where the reference cannot tell.
    """
    road = road_figures(track, outage)
    distance = road["distance_m"]
    horizontal = errors["horizontal"].to_numpy()
    final = float(horizontal[-1])
    percent = 100.0 / distance if distance > 0.0 else math.nan
    inside = errors["in_ellipse"].to_numpy()
    return {
        **road,
        **_three("horizontal_error_m", horizontal),
        **_three("azimuth_error_deg", np.degrees(errors["azimuth"].to_numpy())),
        **_three("height_error_m", errors["up"].to_numpy()),
        **_three("velocity_error_m_per_s", errors["velocity"].to_numpy()),
        "max_horizontal_error_percent": float(horizontal.max()) * percent,
        "final_horizontal_error_percent": final * percent,
        "rms_along_track_error_m": _rms(errors["along"].to_numpy()),
        "rms_cross_track_error_m": _rms(errors["cross"].to_numpy()),
        "final_along_track_error_m": _last(errors["along"].to_numpy()),
        "final_cross_track_error_m": _last(errors["cross"].to_numpy()),
        "first_horizontal_error_m": float(horizontal[0]),
        "share_in_95_ellipse": float(np.mean(inside)) if np.isfinite(inside).all() else math.nan,
        "final_in_95_ellipse": _last(inside),
        "reference_samples": float(horizontal.size),
    }


def road_figures(track: Track, outage: Outage) -> dict[str, float]:
    """Return the figures of an outage that do not depend on any solution.

    Args:
        track: The reference, of the whole drive.
        outage: The outage.
    """
    return {
        "distance_m": _through(driven(track), track, outage),
        "turned_deg": math.degrees(_through(turned(track), track, outage)),
    }


def check_solution(solution: pd.DataFrame, outage: Outage) -> None:
    """Raise if a solution table cannot be scored.

    Args:
        solution: The table.
        outage: The outage that it must cover, but for :data:`SLACK`.

    Raises:
        ShapeError: A column is missing, or times do not increase.
        FilterDivergedError: A position is not finite.
        LogError: It does not cover the outage.
    """
    where = f"solution of the outage at {outage.start:g} s"
    missing = [name for name in REQUIRED if name not in solution.columns]
    if missing or solution.empty:
        raise ShapeError(
            f"{where}: {len(solution)} rows, missing columns {missing}; expected rows with "
            f"{', '.join(REQUIRED)}"
        )
    t = solution["t"].to_numpy(dtype=np.float64)
    if not (np.diff(t) > 0.0).all():
        raise ShapeError(f"{where}: times do not increase strictly; sort it by t")
    finite = np.isfinite(solution[["lat", "lon"]].to_numpy(dtype=np.float64)).all(axis=1)
    if not finite.all():
        bad = float(t[int(np.argmin(finite))])
        raise FilterDivergedError(f"{where}: the position is not finite from {bad:g} s on")
    if t[0] > outage.start + SLACK or t[-1] < outage.end - SLACK:
        raise LogError(
            f"{where}: it runs from {t[0]:g} to {t[-1]:g} s; expected {outage.start:g} to "
            f"{outage.end:g} s"
        )


def direction_of_travel(track: Track) -> Array:
    """Return the direction in which the car drives, held while it is unknown.

    Args:
        track: The reference.

    Returns:
        Angle, rad, clockwise from north, shape (T,); NaN if never known.
    """
    direction = pd.Series(track.azimuth)
    return np.asarray(direction.ffill().bfill(), dtype=np.float64)


def wrap(angle: Array) -> Array:
    """Return angles wrapped to [−π, π).

    Args:
        angle: Angles, rad.
    """
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi, dtype=np.float64)


def _along_and_cross(east: Array, north: Array, direction: Array) -> tuple[Array, Array]:
    s, c = np.sin(direction), np.cos(direction)
    return east * s + north * c, east * c - north * s


def _in_ellipse(
    solution: pd.DataFrame, at: Callable[[str], Array], east: Array, north: Array
) -> Array:
    if any(name not in solution.columns for name in COVARIANCE):
        return np.full(east.shape, np.nan)
    p_ee, p_nn, p_en = at("std_e") ** 2, at("std_n") ** 2, at("cov_en")
    determinant = p_ee * p_nn - p_en**2
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = (p_nn * east**2 - 2.0 * p_en * east * north + p_ee * north**2) / determinant
        inside = (distance <= ELLIPSE_95) & (determinant > 0.0)
    return np.where(np.isfinite(determinant), inside.astype(np.float64), np.nan)


def _through(running_total: Array, track: Track, outage: Outage) -> float:
    first, last = np.interp([outage.start, outage.end], track.t, running_total)
    return float(last - first)


def _three(name: str, values: Array) -> dict[str, float]:
    known = np.abs(values[np.isfinite(values)])
    largest = float(known.max()) if known.size else math.nan
    last = abs(_last(values))
    return {f"max_{name}": largest, f"rms_{name}": _rms(values), f"final_{name}": last}


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def _last(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known[-1]) if known.size else math.nan
