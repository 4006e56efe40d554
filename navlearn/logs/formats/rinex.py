"""Ranges from RINEX: what a receiver measured, with the satellites that broadcast orbits tell.

Each range gets the satellite's position, velocity and clock when it sent, in axes of that
moment. Ionosphere, troposphere and rotation of the Earth are left to whoever knows where the car
is (:mod:`navlearn.logs.range_tensors`); the broadcast ionosphere goes along.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import torch

from navlearn.errors import ConfigError, LogError
from navlearn.gnss import signals
from navlearn.gnss.gnss_time import BEIDOU_BEHIND, WEEK, gps_from_utc, leap_seconds
from navlearn.logs.formats.finding import existing_file
from navlearn.logs.formats.rinex_navigation import Navigation, read_navigation
from navlearn.logs.formats.rinex_observations import Observations, read_observations
from navlearn.logs.formats.rinex_orbits import UNHEALTHY, VALID_FOR, Sent, satellites_when_sent
from navlearn.logs.interval_means import FloatArray
from navlearn.logs.table_layout import Table

_EPOCH: Final = datetime(1980, 1, 6, tzinfo=UTC)


@dataclass(frozen=True, kw_only=True)
class RinexRanges:
    """Ranges of a RINEX file.

    Attributes:
        table: Columns of :data:`navlearn.logs.columns.RANGES`, ``t`` on the log's clock.
        klobuchar: Ionosphere as GPS broadcast it; empty where the file tells none.
        gps_time_origin: What the zero of the log's clock was, GPS seconds.
        notes: What was read and left out, for the log's metadata.
    """

    table: pd.DataFrame
    klobuchar: tuple[float, ...]
    gps_time_origin: float
    notes: Mapping[str, object] = field(default_factory=dict)


def rinex_of_table(folder: Path, layout: Table) -> RinexRanges:
    """Return the ranges of the RINEX files that a descriptor names.

    Args:
        folder: Folder of the log.
        layout: Table ``ranges`` of the descriptor.

    Raises:
        ConfigError: It names no file of orbits, or a code of another carrier.
        MissingExtraError: georinex is not installed.
        LogError: A file is missing or cannot be read, or no satellite has an orbit.
    """
    if not layout.navigation:
        raise ConfigError(
            "tables.ranges: a RINEX file of ranges tells no orbits; state navigation: the file, or "
            "files, of what the satellites broadcast"
        )
    names = (layout.navigation,) if isinstance(layout.navigation, str) else layout.navigation
    return read_rinex(
        existing_file(folder, layout.file),
        [existing_file(folder, name) for name in names],
        codes={str(letter): codes for letter, codes in (layout.codes or {}).items()},
        clock_start=layout.clock_start,
    )


def read_rinex(
    observations: Path,
    navigation: Sequence[Path],
    *,
    codes: Mapping[str, Sequence[str]] | None = None,
    clock_start: datetime | None = None,
) -> RinexRanges:
    """Return the ranges of an observation file with their satellites.

    Satellites without a valid, healthy broadcast orbit are left out; a warning names them.

    Args:
        observations: RINEX 2 or 3 observation file.
        navigation: Navigation files of the same hours, one or one per constellation.
        codes: Codes by constellation in order of preference; L1 C/A and its like where left out.
        clock_start: What UTC it was when the log's clock read zero; None where that clock counts
            UTC seconds since 1970.

    Raises:
        MissingExtraError: georinex is not installed.
        LogError: A file cannot be read, or no satellite has an orbit.
    """
    found = read_observations(observations, codes)
    t = _gps_time(found)
    table = found.table
    span = (float(t.min()), float(t.max()))
    letters = "".join(sorted(set(table["satellite"].str[0]) & set(VALID_FOR)))
    broadcast = read_navigation(navigation, found.week, span, letters)
    stamp = torch.tensor(t - table["pseudorange"].to_numpy(np.float64) / signals.SPEED_OF_LIGHT)
    sent = satellites_when_sent(broadcast, table["satellite"].tolist(), stamp)
    files = ", ".join(path.name for path in navigation)
    _tell_missing(observations.name, files, sent, len(table))
    origin = _clock_zero(clock_start, found.week * WEEK + span[0])
    ranges = _table(table, t + (found.week * WEEK - origin), sent)
    return RinexRanges(
        table=ranges,
        klobuchar=broadcast.klobuchar,
        gps_time_origin=origin,
        notes=_notes(found, broadcast, sent),
    )


def _gps_time(found: Observations) -> FloatArray:
    """Return times of reception on GPS time, s from the beginning of the file's week."""
    t: FloatArray = found.table["t"].to_numpy(np.float64)
    if found.time_system == "BDT":
        return t + BEIDOU_BEHIND
    if found.time_system == "GLO":
        begin = torch.tensor(found.week * WEEK, dtype=torch.float64)
        utc = torch.tensor(t)
        leaps: FloatArray = (gps_from_utc(utc + begin) - utc - begin).round().numpy()
        return t + leaps
    if found.time_system in ("GPS", "GAL", "QZS", "GAT", "QZT"):
        return t
    raise LogError(
        f"time system {found.time_system!r} of the observation file is not known; expected GPS, "
        "GAL, QZS, BDT or GLO"
    )


def _clock_zero(clock_start: datetime | None, first: float) -> float:
    """Return the GPS seconds at which the log's clock read zero."""
    if clock_start is not None:
        utc = (clock_start - _EPOCH) / timedelta(seconds=1)
        return float(gps_from_utc(torch.tensor(utc, dtype=torch.float64)))
    # UTC since 1970 as it counts in this drive, without the leap seconds in between
    since_1970 = (_EPOCH - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(seconds=1)
    return float(leap_seconds(torch.tensor(first, dtype=torch.float64))) - since_1970


def _table(table: pd.DataFrame, t: FloatArray, sent: Sent) -> pd.DataFrame:
    position, velocity = sent.state.position.numpy(), sent.state.velocity.numpy()
    carrier = _carrier(table["satellite"], sent.channel)
    rate = -table["doppler"].to_numpy(np.float64) * signals.SPEED_OF_LIGHT / carrier
    ranges = pd.DataFrame(
        {
            "t": t,
            "satellite": table["satellite"],
            "pseudorange": table["pseudorange"],
            "range_rate": rate,
            "cn0": table["cn0"],
            **{f"sat_{axis}": position[:, k] for k, axis in enumerate("xyz")},
            **{f"sat_v{axis}": velocity[:, k] for k, axis in enumerate("xyz")},
            "sat_clock": sent.state.clock.numpy(),
            "sat_clock_rate": sent.state.clock_rate.numpy(),
        }
    )
    return ranges[sent.known].reset_index(drop=True)


def _carrier(satellite: "pd.Series[str]", channel: FloatArray) -> FloatArray:
    letter = satellite.str[0].to_numpy()
    carrier: FloatArray = np.full(letter.size, signals.L1)
    carrier[letter == "C"] = signals.B1I
    glonass = signals.G1 + signals.G1_STEP * channel
    return np.where(letter == "R", glonass, carrier)


def _tell_missing(observations: str, navigation: str, sent: Sent, ranges: int) -> None:
    told = "; ".join(
        f"{reason}: {', '.join(sorted(names))}" for reason, names in sent.missing.items()
    )
    lost = int((~sent.known).sum())
    if lost == ranges:
        raise LogError(
            f"{observations}: no satellite has a usable orbit in {navigation} ({told}); name the "
            "navigation file of the same hours and constellations"
        )
    if set(sent.missing) - {UNHEALTHY}:
        warnings.warn(
            f"{observations}: {lost} of {ranges} ranges are left out for want of a usable orbit "
            f"in {navigation} ({told}); a navigation file of the whole day and all "
            "constellations gives back all but those of unhealthy satellites",
            stacklevel=5,
        )


def _notes(found: Observations, broadcast: Navigation, sent: Sent) -> dict[str, object]:
    notes: dict[str, object] = {
        "format": "rinex",
        "codes": dict(found.codes),
        "receptions": int(found.table["t"].nunique()),
        **found.counts,
    }
    if found.position:
        notes["position in the header, m"] = list(found.position)
    if broadcast.incomplete:
        notes["incomplete navigation messages"] = broadcast.incomplete
    if sent.missing:
        notes["left out"] = sent.missing
    return notes
