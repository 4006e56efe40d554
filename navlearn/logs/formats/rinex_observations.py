"""Observation files of RINEX 2 and 3: code, Doppler and signal strength of each reception.

georinex opens and unpacks a file (gzip, bzip2, zip, Z, Hatanaka) and tells its header. The records
are cut by columns here, [RINEX3] table A3 and its like of version 2.11: the library takes time
quadratic in receptions (19 s for 610 of them, where this takes a second), and stops at the first
event.
"""

import itertools
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any, Final, TextIO

import pandas as pd

from navlearn.errors import LogError, MissingExtraError

CODES: Final[Mapping[str, tuple[str, ...]]] = {
    "G": ("C1C", "C1L", "C1X", "C1S", "C1W", "C1P", "C1", "P1"),
    "R": ("C1C", "C1P", "C1", "P1"),
    "E": ("C1C", "C1X", "C1B", "C1Z", "C1"),
    "C": ("C2I", "C2X", "C2Q", "C1I", "C2"),
    "J": ("C1C", "C1X", "C1L", "C1S", "C1Z", "C1"),
}
"""Codes on L1, E1 or B1I by constellation, the first that a file has is read. Names of one digit
are those of RINEX 2; C1I is B1I in files of version 3.02."""

WEEK: Final = 604800.0
_WIDTH: Final = 16
_DAMAGE: Final = (OSError, EOFError, zlib.error, UnicodeDecodeError)
_FIRST_DAY: Final = date(1980, 1, 6).toordinal()


@dataclass(frozen=True, kw_only=True)
class Observations:
    """What a receiver wrote.

    Attributes:
        table: ``t``, ``satellite``, ``pseudorange`` (m), ``doppler`` (Hz), ``cn0`` (dB-Hz); ``t``
            counts seconds from the beginning of ``week``, on the clock of ``time_system``.
        week: Week since 6 January 1980 in which the file begins.
        time_system: ``GPS``, ``GAL``, ``QZS``, ``BDT`` or ``GLO`` (UTC).
        codes: Code that was read by constellation.
        counts: What was left out, and how often.
    """

    table: pd.DataFrame
    week: int
    time_system: str
    codes: Mapping[str, str]
    counts: Mapping[str, int] = field(default_factory=dict)


def georinex() -> Any:
    """Return the library that knows RINEX.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        import georinex
    except ImportError as error:
        raise MissingExtraError(
            "reading RINEX needs georinex; pip install navlearn[gnss]"
        ) from error
    return georinex


def rinex_header(path: Path, kind: str) -> Mapping[Any, Any]:
    """Return what the first line of a RINEX file says, where it is of a kind and version known.

    Args:
        path: File.
        kind: ``obs`` or ``nav``.

    Raises:
        MissingExtraError: georinex is not installed.
        LogError: It is empty, damaged, of another kind, or of another version than 2 and 3.
    """
    name = {"obs": "an observation", "nav": "a navigation"}[kind]
    try:
        info: Mapping[Any, Any] = georinex().rinexinfo(path)
    except _DAMAGE as error:
        raise LogError(f"{path.name}: not readable ({error}); it is truncated") from error
    except (ValueError, TypeError, IndexError) as error:
        raise LogError(
            f"{path.name}: no RINEX file ({error}); expected {name} file of version 2 or 3"
        ) from error
    if info.get("rinextype") != kind:
        raise LogError(
            f"{path.name}: a RINEX file of type {info.get('rinextype')}; expected {name} file"
        )
    if not 2.0 <= float(info["version"]) < 4.0:
        raise LogError(
            f"{path.name}: RINEX version {info['version']}; versions 2 and 3 are read, convert it"
        )
    return info


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
    """
    info = rinex_header(path, "obs")
    preference = {**CODES, **(codes or {})}
    try:
        with georinex().rio.opener(path) as stream:
            reader = _Reader(path.name, stream, int(float(info["version"])), preference)
            rows = list(reader.rows())
    except _DAMAGE as error:
        raise LogError(
            f"{path.name}: not readable ({error}); it is truncated or damaged"
        ) from error
    if not rows:
        raise LogError(
            f"{path.name}: no pseudorange of a known code; its header names "
            f"{reader.told()}, looked for {', '.join(map(str, preference.values()))}"
        )
    table = pd.DataFrame(rows, columns=["t", "satellite", "pseudorange", "doppler", "cn0"]).astype(
        {"pseudorange": float, "doppler": float, "cn0": float}
    )
    return Observations(
        table=table,
        week=reader.week or 0,
        time_system=reader.time_system,
        codes=reader.codes,
        counts=dict(reader.counts),
    )


class _Reader:
    """Cuts the records of one open file."""

    def __init__(
        self, name: str, stream: TextIO, version: int, preference: Mapping[str, Sequence[str]]
    ) -> None:
        self.name, self.version, self.stream = name, version, stream
        self.counts: Counter[str] = Counter()
        self.week: int | None = None
        self.fields = self._header()
        self.columns: dict[str, list[int | None]] = {}
        self.codes: dict[str, str] = {}
        for letter, names in self.fields.items():
            for constellation in CODES if letter == "*" else (letter,):
                self._choose(constellation, names, preference.get(constellation, ()))

    def _header(self) -> dict[str, list[str]]:
        library = georinex()
        try:
            if self.version == 3:
                header = library.obs3.obsheader3(self.stream)
                fields: dict[str, list[str]] = header["fields"]
            else:
                header = library.obs2.obsheader2(self.stream)
                fields = {"*": header["fields"]}
        except (ValueError, KeyError, IndexError, AssertionError, TypeError) as error:
            raise LogError(
                f"{self.name}: its header cannot be read ({type(error).__name__}: {error}); it "
                "is truncated or damaged"
            ) from error
        first = str(header.get("TIME OF FIRST OBS", ""))[48:51].strip()
        own = {"R": "GLO", "E": "GAL", "J": "QZS", "C": "BDT"}
        self.time_system = first or own.get(str(header.get("systems")), "GPS")
        return fields

    def told(self) -> str:
        """Return the observations that the header names, for messages."""
        return "; ".join(f"{letter} {' '.join(names)}" for letter, names in self.fields.items())

    def _choose(self, letter: str, names: Sequence[str], wanted: Sequence[str]) -> None:
        code = next((code for code in wanted if code in names), None)
        if code is None:
            return
        # P1 is accompanied by D1 and S1, C1X by D1X and S1X
        beside = [kind + code[1:] for kind in "DS"]
        self.codes[letter] = code
        self.columns[letter] = [
            names.index(name) if name in names else None for name in (code, *beside)
        ]

    def rows(self) -> Iterator[tuple[float, str, float, float, float]]:
        """Yield time, satellite, pseudorange, Doppler and C/N0."""
        records = self._records_3() if self.version == 3 else self._records_2()
        seen: set[float] = set()
        for t, lines in records:
            if t in seen:
                self.counts["receptions that came twice"] += 1
                continue
            seen.add(t)
            yield from self._reception(t, lines)

    def _reception(
        self, t: float, lines: Sequence[tuple[str, str]]
    ) -> Iterator[tuple[float, str, float, float, float]]:
        twice: set[str] = set()
        for satellite, text in lines:
            columns = self.columns.get(satellite[0])
            if columns is None:
                continue
            pseudorange, doppler, cn0 = (self._value(text, column) for column in columns)
            if pseudorange is None:
                continue
            if satellite in twice:
                self.counts["satellites that came twice in a reception"] += 1
                continue
            twice.add(satellite)
            nan = float("nan")
            yield (
                t,
                satellite,
                pseudorange,
                nan if doppler is None else doppler,
                cn0 or nan,
            )

    def _value(self, text: str, column: int | None) -> float | None:
        found = "" if column is None else text[column * _WIDTH : column * _WIDTH + 14].strip()
        if not found:
            return None
        try:
            # a zero stands for what was not received
            return float(found) or None
        except ValueError as error:
            raise LogError(
                f"{self.name}: found {found!r} where an observation should stand ({text[:60]!r}); "
                "the file is damaged"
            ) from error

    def _records_3(self) -> Iterator[tuple[float, list[tuple[str, str]]]]:
        for line in self.stream:
            if not line.strip():
                continue
            flag, count = self._announced(line, line[31:32], line[32:35], line.startswith(">"))
            body = [text.rstrip("\n") for text in itertools.islice(self.stream, count)]
            if self._skipped(flag, body, count):
                continue
            t = self._time(line, line[2:6], line[7:9], line[10:12], line[13:15], line[16:18], 18)
            yield t, [(self._satellite(text[:3]), text[3:]) for text in body]

    def _records_2(self) -> Iterator[tuple[float, list[tuple[str, str]]]]:
        length = -(-len(self.fields["*"]) // 5)
        for line in self.stream:
            if not line.strip():
                continue
            flag, count = self._announced(line, line[28:29], line[29:32], True)
            if flag in "01":
                names = line[32:68].rstrip("\n")
                for more in itertools.islice(self.stream, max(0, -(-count // 12) - 1)):
                    names += more[32:68].rstrip("\n")
            needed = count * (length if flag in "016" else 1)
            body = [text.rstrip("\n") for text in itertools.islice(self.stream, needed)]
            if self._skipped(flag, body, needed):
                continue
            year = int(line[1:3])
            century = str(year + (1900 if year >= 80 else 2000))
            t = self._time(line, century, line[4:6], line[7:9], line[10:12], line[13:15], 15)
            yield (
                t,
                [
                    (
                        self._satellite(names[3 * k : 3 * k + 3]),
                        "".join(f"{part[:80]:80}" for part in body[k * length : (k + 1) * length]),
                    )
                    for k in range(count)
                ],
            )

    def _announced(self, line: str, flag: str, count: str, begins: bool) -> tuple[str, int]:
        try:
            if begins and (flag.strip() or "0") in "0123456":
                return flag.strip() or "0", int(count)
        except ValueError:
            pass
        raise LogError(
            f"{self.name}: expected the line that begins a reception, found {line.rstrip()!r}; "
            "the file is damaged"
        )

    def _skipped(self, flag: str, body: Sequence[str], count: int) -> bool:
        if len(body) < count:
            self.counts["receptions cut off at the end"] += 1
            return True
        if flag in "01":
            return False
        if any("TYPES OF OBSERV" in text[60:] or "OBS TYPES" in text[60:] for text in body):
            raise LogError(
                f"{self.name}: its observation types change in the middle; split it there"
            )
        self.counts["events"] += 1
        return True

    def _time(
        self, line: str, year: str, month: str, day: str, hour: str, minute: str, second: int
    ) -> float:
        try:
            days = date(int(year), int(month), int(day)).toordinal() - _FIRST_DAY
            seconds = float(line[second : second + 11])
            self.week = days // 7 if self.week is None else self.week
            days -= 7 * self.week
            return days * 86400.0 + int(hour) * 3600.0 + int(minute) * 60.0 + seconds
        except ValueError as error:
            raise LogError(
                f"{self.name}: no time in {line.rstrip()!r} ({error}); the file is damaged"
            ) from error

    def _satellite(self, name: str) -> str:
        letter, number = name[:1].replace(" ", "G"), name[1:].replace(" ", "0")
        if letter.isalpha() and len(number) == 2 and number.isdigit():
            return letter + number
        raise LogError(
            f"{self.name}: found {name!r} where a satellite such as G07 should stand; the file is "
            "damaged"
        )
