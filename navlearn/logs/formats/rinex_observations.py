"""Observation files of RINEX 2 and 3: code, Doppler and signal strength of each reception.

georinex opens and unpacks a file (gzip, bzip2, zip, Z, Hatanaka) and tells its header. The records
are cut here: the library takes time quadratic in receptions (19 s for 610 of them, where this
takes a second), and stops at the first event.
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import pandas as pd

from navlearn.errors import ConfigError, LogError
from navlearn.logs.formats.rinex_header import (
    DAMAGE,
    ObservationHeader,
    georinex,
    observation_header,
    rinex_version,
)
from navlearn.logs.formats.rinex_records import WIDTH, Reception, receptions

CODES: Final[Mapping[str, tuple[str, ...]]] = {
    "G": ("C1C", "C1L", "C1X", "C1S", "C1W", "C1P", "C1", "P1"),
    "R": ("C1C", "C1P", "C1", "P1"),
    "E": ("C1C", "C1X", "C1B", "C1Z", "C1"),
    "C": ("C2I", "C2X", "C2Q", "C1I", "C2"),
    "J": ("C1C", "C1X", "C1L", "C1S", "C1Z", "C1"),
}
"""Codes on L1, E1 or B1I by constellation, the first that a file has is read. Names of one digit
are those of RINEX 2; C1I is B1I in files of version 3.02."""

Row = tuple[float, str, float, float, float]
Columns = Mapping[str, Sequence[int | None]]


@dataclass(frozen=True, kw_only=True)
class Observations:
    """What a receiver wrote.

    Attributes:
        table: ``t``, ``satellite``, ``pseudorange`` (m), ``doppler`` (Hz), ``cn0`` (dB-Hz); ``t``
            counts seconds from the beginning of ``week``, on the clock of ``time_system``.
        week: Week since 6 January 1980 in which the file begins.
        time_system: ``GPS``, ``GAL``, ``QZS``, ``BDT`` or ``GLO`` (UTC).
        codes: Code that was read by constellation.
        position: Where the antenna stood by the header, Earth-fixed, m; empty if it does not say.
        counts: What was left out, and how often.
    """

    table: pd.DataFrame
    week: int
    time_system: str
    codes: Mapping[str, str]
    position: tuple[float, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)


def read_observations(path: Path, codes: Mapping[str, Sequence[str]] | None = None) -> Observations:
    """Return code, Doppler and C/N0 of each reception and satellite of a file.

    Events are skipped. A reception that comes twice, a satellite that comes twice in one, and a
    last reception that is cut off are left out and counted.

    Args:
        path: RINEX 2 or 3 observation file, compressed or not.
        codes: Codes by constellation in order of preference, over :data:`CODES`.

    Raises:
        MissingExtraError: georinex is not installed.
        LogError: It cannot be read, or holds no reception of a known code.
        ConfigError: A code is of another carrier than L1, E1 or B1I.
    """
    _refuse_other_carriers(codes or {})
    version = rinex_version(path, "obs")
    counts: Counter[str] = Counter()
    rows: list[Row] = []
    week: int | None = None
    seen: set[tuple[int, float]] = set()
    try:
        with georinex().rio.opener(path) as stream:
            header = observation_header(path.name, stream, version)
            chosen, columns = _chosen(header, {**CODES, **(codes or {})})
            for reception in receptions(path.name, stream, header, counts):
                if (reception.day, reception.second) in seen:
                    counts["receptions that came twice"] += 1
                    continue
                seen.add((reception.day, reception.second))
                week = reception.day // 7 if week is None else week
                t = 86400.0 * (reception.day - 7 * week) + reception.second
                rows.extend(_rows(path.name, t, reception, columns, counts))
    except DAMAGE as error:
        raise LogError(
            f"{path.name}: not readable ({error}); it is truncated or damaged"
        ) from error
    if week is None or not rows:
        looked = "; ".join(
            f"{letter} {' '.join(names)}" for letter, names in {**CODES, **(codes or {})}.items()
        )
        raise LogError(
            f"{path.name}: no pseudorange of a known code; its header names {header.told}, looked "
            f"for {looked}"
        )
    return Observations(
        table=pd.DataFrame(rows, columns=["t", "satellite", "pseudorange", "doppler", "cn0"]),
        week=week,
        time_system=header.time_system,
        codes=chosen,
        position=header.position,
        counts=dict(counts),
    )


def _refuse_other_carriers(codes: Mapping[str, Sequence[str]]) -> None:
    # their Doppler, ionosphere and group delay would be taken for those of L1
    for letter, wanted in codes.items():
        on_it = re.compile("C2[A-Z]?|C1I" if letter == "C" else "C1[A-Z]?|P1")
        other = [code for code in wanted if not on_it.fullmatch(code)]
        if other:
            raise ConfigError(
                f"codes.{letter}: found {', '.join(other)}; ranges are read of "
                f"{'B1I (C2I and its like)' if letter == 'C' else 'L1 or E1 (C1C and its like)'} "
                "alone"
            )


def _chosen(
    header: ObservationHeader, preference: Mapping[str, Sequence[str]]
) -> tuple[dict[str, str], dict[str, list[int | None]]]:
    """Return by constellation the code and where it, its Doppler and its C/N0 stand."""
    codes, columns = {}, {}
    for letter, wanted in preference.items():
        names = header.fields.get(letter, header.fields.get("*", ()))
        code = next((code for code in wanted if code in names), None)
        if code is None:
            continue
        codes[letter] = code
        # C1X goes with D1X and S1X, P1 with D1 and S1
        triple = (code, "D" + code[1:], "S" + code[1:])
        columns[letter] = [names.index(name) if name in names else None for name in triple]
    return codes, columns


def _rows(
    where: str, t: float, reception: Reception, columns: Columns, counts: Counter[str]
) -> Iterator[Row]:
    seen: set[str] = set()
    for satellite, text in reception.lines:
        places = columns.get(satellite[0])
        if places is None:
            continue
        pseudorange, doppler, cn0 = (_value(where, text, place) for place in places)
        if math.isnan(pseudorange):
            continue
        if satellite in seen:
            counts["satellites that came twice in a reception"] += 1
            continue
        seen.add(satellite)
        yield t, satellite, pseudorange, doppler, cn0


def _value(where: str, text: str, place: int | None) -> float:
    found = "" if place is None else text[place * WIDTH : place * WIDTH + 14].strip()
    try:
        value = float(found or 0.0)
    except ValueError:
        value = math.inf
    if not math.isfinite(value):
        raise LogError(
            f"{where}: found {found!r} where an observation should stand ({text[:60]!r}); the "
            "file is damaged"
        )
    # a zero, like a blank, stands for what was not received
    return value or math.nan
