"""Every measurement that a filter refused over a drive, with its reason, as tables."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from navlearn.fusion.measurements import Rows, Verdict
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic.faults import injected_faults
from navlearn.outages.track import Array, Track, enu_metres, track_of

REFUSED: Final = (
    Verdict.REFUSED_BY_GATE,
    Verdict.REFUSED_BY_PREDICTION,
    Verdict.REFUSED_BY_MOTION,
)
"""Verdicts of a measurement that did nothing."""

TOLD: Final = (*REFUSED, Verdict.ACCEPTED_BY_RESET, Verdict.ACCEPTED_WITH_LESS_WEIGHT)
"""Verdicts that the table lists: all but those of what was simply believed."""

NEAR: Final = 1e-3
"""Two times of a fix are the same that lie this near, s."""

UNITS: Final = {
    "position": "m",
    "velocity": "m/s",
    "course": "rad",
    "odometer": "m/s",
    "nonholonomic": "m/s",
    "zero_yaw_rate": "rad/s",
    "zero_speed": "m/s",
    "zero_velocity": "m/s",
}
"""Unit of the innovation of each kind of measurement."""

_AXES: Final = ("east", "north", "up")
_ALONG_AXES: Final = ("position", "velocity")


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgements:
    """What a filter made of its measurements over a drive: K moments, r rows, kinds.

    Attributes:
        t: When each was valid, s, shape (K,).
        rows: Rows of each kind.
        kinds: Names of all kinds that the filter knows, in the order of per-kind axes.
        innovation: Measured minus predicted, NaN where nothing was measured, shape (K, r).
        nis: Normalised innovation squared, NaN where nothing was measured, shape (K, kinds).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, shape (K, kinds).
        weight: What share of its information each was taken with, shape (K, kinds).
        stated: Deviation that the receiver stated, NaN where it has no say, shape (K, kinds).
        nis_limit: Largest NIS that passes, NaN for kinds not taken, shape (kinds,).
        limits: Limits in metres by verdict, such as that of the prediction.
    """

    t: Array
    rows: Rows
    kinds: tuple[str, ...]
    innovation: Array
    nis: Array
    verdict: np.ndarray
    weight: Array
    stated: Array
    nis_limit: Array
    limits: dict[int, float]


def refused_table(judgements: Judgements, log: DriveLog | None = None) -> pd.DataFrame:
    """Return what was refused, taken by a reset, or taken with less than half its weight.

    Args:
        judgements: What a filter made of its measurements.
        log: The drive: by its reference positions are judged afterwards, and it tells which
            faults were put into it; no filter knows of either.

    Returns:
        A row per measurement, in order of time: ``t`` (s), ``kind``, ``verdict``; ``innovation``
        (horizontal where it has directions) in ``unit``, and ``east``, ``north``, ``up`` of it;
        ``nis`` and ``nis_limit``; ``limit_m``, the limit in metres that refused it; ``weight``;
        ``stated_deviation``; ``fix_error_m``, how far a position is horizontally off the
        reference; and ``fault``, the number of the fault put into it, 0 for none.
    """
    parts = [
        _of_kind(judgements, index, name)
        for index, name in enumerate(judgements.kinds)
        if any(int(kind) == index for kind in judgements.rows.kinds)
    ]
    table = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=COLUMNS)
    table = table.sort_values(["t", "kind"], kind="stable", ignore_index=True)
    t = table["t"].to_numpy(np.float64)
    errors = np.full(t.shape, np.nan)
    if log is not None and log.reference is not None:
        positions = (table["kind"] == "position").to_numpy()
        errors = np.where(positions, fix_errors(t, log.fixes, track_of(log)), np.nan)
    faults = None if log is None else injected_faults(log)
    return table.assign(fix_error_m=errors, fault=fault_at(t, faults))


COLUMNS: Final = (
    *("t", "kind", "verdict", "innovation", "unit", *_AXES, "nis", "nis_limit", "limit_m"),
    *("weight", "stated_deviation"),
)
"""Columns of the table, but what only a judge knows."""


def _of_kind(found: Judgements, index: int, name: str) -> pd.DataFrame:
    verdict = found.verdict[:, index]
    at = np.flatnonzero(np.isin(verdict, TOLD))
    kind = next(one for one in found.rows.kinds if int(one) == index)
    innovation = found.innovation[at, found.rows.of(kind)]
    axes = np.full((at.size, 3), np.nan)
    if name in _ALONG_AXES:
        axes[:, : innovation.shape[1]] = innovation
        size = np.hypot(axes[:, 0], axes[:, 1])
    else:
        size = innovation[:, 0] if innovation.shape[1] == 1 else np.linalg.norm(innovation, axis=1)
    table = pd.DataFrame(
        {
            "t": found.t[at],
            "kind": name,
            "verdict": [Verdict(one).name.lower() for one in verdict[at]],
            "innovation": size,
            "unit": UNITS[name],
            **dict(zip(_AXES, axes.T, strict=True)),
            "nis": found.nis[at, index],
            "nis_limit": found.nis_limit[index],
            "limit_m": [found.limits.get(int(one), np.nan) for one in verdict[at]],
            "weight": found.weight[at, index],
            "stated_deviation": found.stated[at, index],
        }
    )
    return table[list(COLUMNS)]


def verdict_counts(judgements: Judgements) -> pd.DataFrame:
    """Return how often each kind of measurement got each verdict over a drive.

    Args:
        judgements: What a filter made of its measurements.

    Returns:
        A row per kind that was measured: ``kind``, ``measured``, and a column per verdict in
        lower case.
    """
    every = enumerate(judgements.kinds)
    rows = [counts_of(name, judgements.verdict[:, index]) for index, name in every]
    return pd.DataFrame([row for row in rows if row["measured"]])


def counts_of(kind: str, verdict: np.ndarray) -> dict[str, object]:
    """Return how often a kind of measurement got each verdict.

    Args:
        kind: Its name.
        verdict: Codes, any shape.
    """
    there = [one for one in Verdict if one is not Verdict.ABSENT]
    counts = {one.name.lower(): int((verdict == int(one)).sum()) for one in there}
    return {"kind": kind, "measured": sum(counts.values()), **counts}


def fix_errors(t: Array, fixes: pd.DataFrame, track: Track) -> Array:
    """Return by how much fixes are horizontally off a track at their times.

    Args:
        t: Times of fixes, s, shape (N,).
        fixes: Fixes with ``t``, ``lat``, ``lon``.
        track: By which they are judged.

    Returns:
        Distance, m, NaN where the track has no position or no fix has the time, shape (N,).
    """
    row = nearest_rows(t, fixes["t"].to_numpy(np.float64))
    lat, lon = (fixes[name].to_numpy(np.float64)[row] for name in ("lat", "lon"))
    inside = (t >= track.t[0]) & (t <= track.t[-1]) & (row >= 0)
    lat_0, lon_0 = (np.interp(t, track.t, one) for one in (track.lat, np.unwrap(track.lon)))
    nothing = np.zeros_like(lat)
    east, north, _ = enu_metres(lat, lon, nothing, lat_0, lon_0, nothing)
    return np.where(inside, np.hypot(east, north), np.nan)


def nearest_rows(t: Array, known: Array) -> np.ndarray:
    """Return which of the known times each time is, −1 where it is none of them.

    Args:
        t: Times, s, shape (N,).
        known: Times, s, increasing, shape (M,).
    """
    if known.size == 0:
        return np.full(t.shape, -1)
    after = np.clip(np.searchsorted(known, t), 1, max(known.size - 1, 1))
    before = after - 1
    after = np.minimum(after, known.size - 1)
    row = np.where(np.abs(known[before] - t) <= np.abs(known[after] - t), before, after)
    return np.where(np.abs(known[row] - t) <= NEAR, row, -1)


def fault_at(t: Array, faults: pd.DataFrame | None) -> np.ndarray:
    """Return the number of the fault at times of fixes, 0 for none.

    Args:
        t: Times, s, shape (N,).
        faults: What :func:`navlearn.logs.synthetic.faults.injected_faults` returns.
    """
    number = np.zeros(t.shape, dtype=np.int64)
    if faults is not None:
        for fault, first, lasts in faults[["fault", "t", "duration"]].to_numpy(np.float64):
            number[(t >= first - NEAR) & (t <= first + lasts + NEAR)] = int(fault)
    return number
