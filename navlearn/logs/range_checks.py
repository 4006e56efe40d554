"""The door of raw ranges: what they must be before anything is computed from them."""

import re
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.columns import REQUIRED

CONSTELLATIONS: Final = "GRECJSI"
"""RINEX letters: GPS, GLONASS, Galileo, BeiDou, QZSS, SBAS, NavIC."""


def checked_ranges(where: str, ranges: pd.DataFrame) -> pd.DataFrame:
    """Return a table of ranges, or refuse it.

    Args:
        where: Name of the table in messages.
        ranges: Columns of :data:`navlearn.logs.columns.RANGES`; the satellite as text, the others
            as numbers.

    Raises:
        LogError: A time is missing or steps back, a satellite has no name that says its
            constellation, or comes twice in one reception, or a required value is missing.
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
        raise LogError(
            f"{where}: time steps back at row {row + 1} ({t[row]:.10g} s after "
            f"{t[row - 1]:.10g} s; {int(back.sum())} such rows); sort the rows by time"
        )
    _require_names(where, satellite)
    twice = ranges.duplicated(["t", "satellite"]).to_numpy()
    if twice.any():
        row = int(np.argmax(twice))
        raise LogError(
            f"{where}: satellite {satellite.iloc[row]} comes twice at {t[row]:.10g} s, again in "
            f"row {row + 1} ({int(twice.sum())} such rows); keep one row per reception and "
            "satellite"
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
    return ranges


def _require_names(where: str, satellite: "pd.Series[str]") -> None:
    pattern = re.compile(f"[{CONSTELLATIONS}][0-9]{{1,3}}")
    known = {name: bool(pattern.fullmatch(name)) for name in satellite.unique()}
    wrong = ~satellite.map(known).to_numpy(dtype=bool)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{where}: satellite is {satellite.iloc[row]!r} at row {row + 1}; expected the RINEX "
            f"letter of its constellation ({CONSTELLATIONS}) and a number, such as G07"
        )
