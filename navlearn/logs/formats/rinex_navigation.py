"""Navigation files of RINEX 2 and 3: broadcast orbits and clocks, by georinex.

[RINEX3] tables A6 to A12. Weeks are not believed but found from the calendar date of the clock,
within half a week of which an orbit's reference time lies: a week told modulo 1024 does no harm.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import torch

from navlearn.errors import LogError
from navlearn.gnss.gnss_time import BEIDOU_BEHIND, WEEK, gps_from_utc, half_week
from navlearn.logs.formats.rinex_header import DAMAGE, georinex, rinex_version
from navlearn.logs.interval_means import FloatArray

KEPLER: Final[Mapping[str, str]] = {
    "clock_bias": "SVclockBias",
    "clock_drift": "SVclockDrift",
    "clock_drift_rate": "SVclockDriftRate",
    "toe_of_week": "Toe",
    "sqrt_a": "sqrtA",
    "eccentricity": "Eccentricity",
    "mean_anomaly": "M0",
    "mean_motion_difference": "DeltaN",
    "perigee": "omega",
    "inclination": "Io",
    "inclination_rate": "IDOT",
    "node": "Omega0",
    "node_rate": "OmegaDot",
    "cuc": "Cuc",
    "cus": "Cus",
    "crc": "Crc",
    "crs": "Crs",
    "cic": "Cic",
    "cis": "Cis",
}
"""Field of the ephemeris to the library's name."""

GLONASS: Final[Mapping[str, str]] = {
    "clock_bias": "SVclockBias",
    "clock_drift": "SVrelFreqBias",
    **{f"position_{axis}": axis.upper() for axis in "xyz"},
    **{f"velocity_{axis}": f"d{axis.upper()}" for axis in "xyz"},
    **{f"acceleration_{axis}": f"d{axis.upper()}2" for axis in "xyz"},
    "channel": "FreqNum",
}
"""The same of GLONASS; the library gives metres."""

_EPOCH: Final = np.datetime64("1980-01-06T00:00:00", "ns")
_MARGIN: Final = timedelta(hours=7)


@dataclass(frozen=True, kw_only=True)
class Navigation:
    """What satellites broadcast.

    Attributes:
        orbits: A row per message: ``satellite``, ``toe``, ``toc`` (GPS seconds from ``week``'s
            beginning), ``healthy``, ``group_delay`` and the fields of :data:`KEPLER`.
        states: The same of GLONASS with the fields of :data:`GLONASS`.
        klobuchar: Ionosphere of GPS, α₀ to α₃ and β₀ to β₃; empty where the file tells none.
        incomplete: Messages left out for want of a number.
    """

    orbits: pd.DataFrame
    states: pd.DataFrame
    klobuchar: tuple[float, ...]
    incomplete: int = 0


def read_navigation(
    paths: Sequence[Path], week: int, span: tuple[float, float], systems: str
) -> Navigation:
    """Return the broadcast orbits and clocks about the time of some receptions.

    Args:
        paths: RINEX navigation files, one or one per constellation.
        week: Week since 6 January 1980 from whose beginning times are counted.
        span: First and last reception, s from that beginning.
        systems: RINEX letters of the constellations needed.

    Raises:
        MissingExtraError: georinex is not installed.
        LogError: A file cannot be read, or none holds a message within hours of the receptions.
    """
    begin = datetime(1980, 1, 6) + timedelta(weeks=week)
    limits = (
        begin + timedelta(seconds=span[0]) - _MARGIN,
        begin + timedelta(seconds=span[1]) + _MARGIN,
    )
    orbits: list[pd.DataFrame] = []
    states: list[pd.DataFrame] = []
    klobuchar: tuple[float, ...] = ()
    incomplete = 0
    for path in paths:
        found = _read(path, systems, limits)
        klobuchar = klobuchar or tuple(
            float(value) for value in found.attrs.get("ionospheric_corr_GPS", ())
        )
        messages = _messages(found)
        for letter, rows in messages.groupby(messages["satellite"].str[0]):
            table = _states(rows, week) if letter == "R" else _orbits(rows, week, str(letter))
            whole = table.notna().all(axis="columns")
            incomplete += int((~whole).sum())
            (states if letter == "R" else orbits).append(table[whole])
    if not any(map(len, (*orbits, *states))):
        raise LogError(
            f"{', '.join(path.name for path in paths)}: no orbit of {', '.join(systems)} within "
            f"hours of the receptions, {limits[0] + _MARGIN:%Y-%m-%d %H:%M} to "
            f"{limits[1] - _MARGIN:%H:%M}; name the navigation file of that day"
        )
    return Navigation(
        orbits=pd.concat(orbits, ignore_index=True) if orbits else pd.DataFrame(),
        states=pd.concat(states, ignore_index=True) if states else pd.DataFrame(),
        klobuchar=klobuchar if len(klobuchar) == 8 else (),
        incomplete=incomplete,
    )


def _read(path: Path, systems: str, limits: tuple[datetime, datetime]) -> Any:
    version = rinex_version(path, "nav")
    library = georinex()
    try:
        with warnings.catch_warnings():
            # of how xarray will join tables in future
            warnings.simplefilter("ignore")
            if version == 3:
                return library.rinexnav3(path, use=set(systems), tlim=limits)
            return library.rinexnav2(path, tlim=limits)
    except DAMAGE as error:
        raise LogError(f"{path.name}: not readable ({error}); it is truncated") from error
    except (ValueError, KeyError, IndexError, TypeError, NotImplementedError) as error:
        raise LogError(
            f"{path.name}: its messages cannot be read ({type(error).__name__}: {error}); it is "
            "truncated or damaged"
        ) from error


def _messages(found: Any) -> pd.DataFrame:
    """Return a row per message, of the library's grid of times and satellites."""
    if "SVclockBias" not in found:
        return pd.DataFrame({"satellite": pd.Series(dtype=str)})
    table: pd.DataFrame = found.to_dataframe().reset_index()
    table = table[table["SVclockBias"].notna()].reset_index(drop=True)
    # a second message of the same time is named G07_1
    return table.assign(satellite=table["sv"].str[:3])


def _orbits(rows: pd.DataFrame, week: int, letter: str) -> pd.DataFrame:
    table = pd.DataFrame({"satellite": rows["satellite"]})
    for name, source in KEPLER.items():
        table[name] = rows[source]
    behind = BEIDOU_BEHIND if letter == "C" else 0.0
    toc = _seconds(rows) + behind - week * WEEK
    toe = table["toe_of_week"] + behind
    table["toc"] = toc
    table["toe"] = toc + half_week(torch.tensor((toe - toc).to_numpy(np.float64))).numpy()
    table["group_delay"], table["preference"] = _group_delay(rows, letter)
    table["healthy"] = _healthy(rows, letter)
    return table


def _states(rows: pd.DataFrame, week: int) -> pd.DataFrame:
    table = pd.DataFrame({"satellite": rows["satellite"]})
    for name, source in GLONASS.items():
        table[name] = rows[source]
    utc = torch.tensor(_seconds(rows).to_numpy(np.float64))
    table["toe"] = gps_from_utc(utc).numpy() - week * WEEK
    table["channel"] = table["channel"].where(table["channel"] <= 128.0, table["channel"] - 256.0)
    table["healthy"] = rows["health"] == 0.0
    return table


def _seconds(rows: pd.DataFrame) -> "pd.Series[float]":
    elapsed: FloatArray = (rows["time"].to_numpy() - _EPOCH) / np.timedelta64(1, "s")
    return pd.Series(elapsed, index=rows.index)


def _group_delay(rows: pd.DataFrame, letter: str) -> tuple["pd.Series[float]", "pd.Series[float]"]:
    """Return the delay of the code on L1, E1 or B1I, s, and which of two messages is preferred."""
    first = pd.Series(1.0, index=rows.index)
    if letter == "C":
        return rows["TGD1"], first
    if letter != "E":
        return rows["TGD"], first
    # bit 1 tells F/NAV, whose clock goes with E5a; I/NAV, sent on E1 itself, comes first
    source = rows["DataSrc"].fillna(0.0).astype(np.int64)
    by_e5a = (source & 0b10) > 0
    return rows["BGDe5b"].where(~by_e5a, rows["BGDe5a"]), first.where(~by_e5a, 0.0)


def _healthy(rows: pd.DataFrame, letter: str) -> "pd.Series[bool]":
    if letter == "C":
        return rows["SatH1"] == 0.0
    if letter == "E":  # the bits that speak of E1
        return (rows["health"].fillna(7.0).astype(np.int64) & 0b111) == 0
    if letter == "J":  # the last bit speaks of another signal
        return (rows["health"].fillna(2.0).astype(np.int64) & ~1) == 0
    return rows["health"] == 0.0
