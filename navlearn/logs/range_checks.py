"""The door of raw ranges: what they must be before anything is computed from them."""

import re
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from navlearn.errors import LogError
from navlearn.gnss.gnss_time import WEEK
from navlearn.logs.columns import RANGE_CORRECTIONS, REQUIRED
from navlearn.logs.drive_log import LogMetadata
from navlearn.logs.nearest import nearest_hint

CONSTELLATIONS: Final = "GRECJSI"
"""RINEX letters: GPS, GLONASS, Galileo, BeiDou, QZSS, SBAS, NavIC."""

NEAREST, FARTHEST = 2.0e7, 5.0e7
"""How far from the Earth's centre satellites of navigation are, m: GLONASS 2.55e7, QZSS 4.6e7."""

SMALLEST, LARGEST = 1.0e6, 1.0e9
"""Between these lies the median pseudorange, m: a receiver's clock may be 60 ms behind."""

LATEST_GPS: Final = 1.0e10
"""GPS time counts no further, s: the year 2296."""


def is_satellite(name: str) -> bool:
    """Tell whether a text names a satellite; of each there is one name, not G7 beside G07.

    Args:
        name: Text.
    """
    return re.fullmatch(f"[{CONSTELLATIONS}](0[1-9]|[1-9][0-9]{{1,2}})", name) is not None


def checked_ranges(where: str, ranges: pd.DataFrame) -> pd.DataFrame:
    """Return a table of ranges, or refuse it.

    Args:
        where: Name of the table in messages.
        ranges: Columns of :data:`navlearn.logs.columns.RANGES`; the satellite as text, the others
            as numbers.

    Raises:
        LogError: A time is missing or steps back, a satellite has no name that says its
            constellation, or comes twice in one reception, a required value is missing, or
            satellites or pseudoranges cannot be in metres.
    """
    t, satellite = ranges["t"].to_numpy(np.float64), ranges["satellite"]
    if np.isnan(t).any():
        raise LogError(
            f"{where}: no time at row {int(np.argmax(np.isnan(t))) + 1} ({int(np.isnan(t).sum())} "
            "such rows); remove the rows or give them times"
        )
    back = np.diff(t) < 0.0
    if back.any():
        row = int(np.argmax(back)) + 1
        step = t[row] - t[row - 1]
        remedy = "sort the rows by time, or set on_backstep: drop in the log's descriptor"
        if abs(step + WEEK) < 0.05 * WEEK:
            remedy = f"a week ended there: add {WEEK:g} s to what follows"
        raise LogError(
            f"{where}: time steps back at row {row + 1} ({t[row]:.10g} s after "
            f"{t[row - 1]:.10g} s; {int(back.sum())} such rows); {remedy}"
        )
    _require_names(where, satellite)
    twice = ranges.duplicated(["t", "satellite"]).to_numpy()
    if twice.any():
        row = int(np.argmax(twice))
        raise LogError(
            f"{where}: satellite {satellite.iloc[row]} comes twice at {t[row]:.10g} s, again in "
            f"row {row + 1} ({int(twice.sum())} such rows); keep one row per reception and "
            "satellite, or set on_backstep: drop in the log's descriptor"
        )
    for column in REQUIRED["ranges"][1:]:
        missing = ranges[column].isna().to_numpy()
        if missing.any():
            row = int(np.argmax(missing))
            raise LogError(
                f"{where}: column {column} has no value at row {row + 1} (satellite "
                f"{satellite.iloc[row]}, {t[row]:.10g} s; {int(missing.sum())} such rows); leave "
                "out what was not received"
            )
    _require_orbits(where, ranges)
    _require_metres(where, ranges["pseudorange"].to_numpy(np.float64))
    return ranges


def check_range_metadata(metadata: LogMetadata) -> None:
    """Refuse what cannot be known about ranges.

    Args:
        metadata: Of the log.

    Raises:
        LogError: A correction has no known name, Klobuchar's coefficients are not eight finite
            numbers, or the time is no GPS time.
    """
    for name in metadata.range_corrections:
        if name not in RANGE_CORRECTIONS:
            raise LogError(
                f"{metadata.name}: range_corrections names {name!r}"
                f"{nearest_hint(str(name), RANGE_CORRECTIONS)}; known are "
                f"{', '.join(RANGE_CORRECTIONS)}"
            )
    told = np.asarray(metadata.klobuchar, dtype=np.float64)
    if told.size not in (0, 8) or not np.isfinite(told).all():
        raise LogError(
            f"{metadata.name}: klobuchar holds {list(metadata.klobuchar)}; expected α₀ to α₃ and "
            "β₀ to β₃, eight numbers, or none"
        )
    origin = metadata.gps_time_origin
    if origin is not None and not 0.0 <= origin <= LATEST_GPS:
        raise LogError(
            f"{metadata.name}: gps_time_origin is {origin:g}; expected GPS seconds since 6 January "
            "1980 (604800 times the full week, not the week modulo 1024, plus seconds of week)"
        )


def _require_orbits(where: str, ranges: pd.DataFrame) -> None:
    axes = [ranges[f"sat_{axis}"].to_numpy(np.float64) for axis in "xyz"]
    with np.errstate(over="ignore"):
        far = np.sqrt(sum(axis * axis for axis in axes))
    wrong = ~((far >= NEAREST) & (far <= FARTHEST))
    if not wrong.any():
        return
    row = int(np.argmax(wrong))
    remedy = "leave out satellites whose orbit is not known"
    if NEAREST <= 1e3 * far[row] <= FARTHEST:
        remedy = "they are in km: give unit: km (or scale: 1000) in a descriptor"
    elif far[row] > FARTHEST and far[row] < 1e3 * FARTHEST:
        remedy = "give their unit in a descriptor"
    raise LogError(
        f"{where}: satellite {ranges['satellite'].iloc[row]} is {far[row]:.6g} m from the Earth's "
        f"centre at row {row + 1} ({int(wrong.sum())} such rows), expected {NEAREST:g} to "
        f"{FARTHEST:g} m; {remedy}"
    )


def _require_metres(where: str, pseudorange: npt.NDArray[np.float64]) -> None:
    if not pseudorange.size:
        return
    middle = float(np.median(np.abs(pseudorange)))
    if SMALLEST <= middle <= LARGEST:
        return
    remedy = "give its unit in a descriptor"
    if 0.01 < middle < 1.0:
        remedy = "they are in s: give scale: 299792458 in a descriptor"
    elif 1e4 < middle < 1e5:
        remedy = "they are in km: give unit: km in a descriptor"
    raise LogError(
        f"{where}: pseudorange is {middle:.6g} in the median, expected metres (some 2e7); {remedy}"
    )


def _require_names(where: str, satellite: "pd.Series[str]") -> None:
    # a missing name is no text, even in a column of texts
    known = [name for name in satellite.dropna().unique() if is_satellite(name)]
    wrong = ~satellite.isin(known).to_numpy(dtype=bool)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{where}: satellite is {satellite.iloc[row]!r} at row {row + 1}; expected the RINEX "
            f"letter of its constellation ({CONSTELLATIONS}) and a number of two digits or more, "
            "such as G07"
        )
