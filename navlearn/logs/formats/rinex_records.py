"""The records of RINEX 2 and 3 observation files, cut by columns.

[RINEX3] table A3, and its like of version 2.11.
"""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Final, TextIO

from navlearn.errors import LogError
from navlearn.logs.formats.rinex_header import ObservationHeader

WIDTH: Final = 16
"""Columns of one observation: 14 for its value, two for its flags."""

_FIRST_DAY: Final = date(1980, 1, 6).toordinal()


@dataclass(frozen=True, kw_only=True)
class Reception:
    """One reception.

    Attributes:
        day: Day since 6 January 1980.
        second: Second of that day.
        lines: Satellite, such as ``G07``, and the text of its observations.
    """

    day: int
    second: float
    lines: Sequence[tuple[str, str]]


def receptions(
    where: str, stream: TextIO, header: ObservationHeader, counts: Counter[str]
) -> Iterator[Reception]:
    """Yield the receptions of a file, without its events.

    Args:
        where: Name of the file, for messages.
        stream: The open file, read up to its records.
        header: What it says of them.
        counts: Takes up how many events were skipped, and whether the last reception is cut off.

    Raises:
        LogError: The file is damaged, or changes its observations in the middle.
    """
    if header.version == 3:
        return _version_3(where, stream, counts)
    return _version_2(where, stream, -(-len(header.fields["*"]) // 5), counts)


def _version_3(where: str, stream: TextIO, counts: Counter[str]) -> Iterator[Reception]:
    for line in stream:
        if not line.strip():
            continue
        flag, count = _announced(where, line, line[31:32], line[32:35])
        body = _lines(stream, count)
        if _skipped(where, flag, body, count, counts):
            continue
        calendar = (line[2:6], line[7:9], line[10:12], line[13:15], line[16:18], line[18:29])
        day, second = _time(where, line, calendar)
        lines = [(_satellite(where, text[:3]), text[3:]) for text in body]
        yield Reception(day=day, second=second, lines=lines)


def _version_2(
    where: str, stream: TextIO, length: int, counts: Counter[str]
) -> Iterator[Reception]:
    for line in stream:
        if not line.strip():
            continue
        flag, count = _announced(where, ">" + line, line[28:29], line[29:32])
        names = line[32:68].rstrip("\n")
        if flag in "01":
            further = itertools.islice(stream, max(0, -(-count // 12) - 1))
            names += "".join(more[32:68].rstrip("\n") for more in further)
        needed = count * (length if flag in "016" else 1)
        body = _lines(stream, needed)
        if _skipped(where, flag, body, needed, counts):
            continue
        calendar = (line[1:3], line[4:6], line[7:9], line[10:12], line[13:15], line[15:26])
        day, second = _time(where, line, calendar)
        lines = [
            (
                _satellite(where, names[3 * k : 3 * k + 3]),
                "".join(f"{part[:80]:80}" for part in body[k * length : (k + 1) * length]),
            )
            for k in range(count)
        ]
        yield Reception(day=day, second=second, lines=lines)


def _lines(stream: TextIO, count: int) -> list[str]:
    return [text.rstrip("\n") for text in itertools.islice(stream, count)]


def _announced(where: str, line: str, flag: str, count: str) -> tuple[str, int]:
    """Return the flag of a reception or event and how many lines or satellites follow."""
    flag = flag.strip() or "0"
    if line.startswith(">") and flag in "0123456" and count.strip().isdecimal():
        return flag, int(count)
    raise LogError(
        f"{where}: expected the line that begins a reception, found "
        f"{line.removeprefix('>').rstrip()!r}; the file is damaged"
    )


def _skipped(where: str, flag: str, body: Sequence[str], count: int, counts: Counter[str]) -> bool:
    if len(body) < count:
        counts["receptions cut off at the end"] += 1
        return True
    if flag in "01":
        return False
    if any("TYPES OF OBSERV" in text[60:] or "OBS TYPES" in text[60:] for text in body):
        raise LogError(f"{where}: its observation types change in the middle; split it there")
    counts["events"] += 1
    return True


def _time(where: str, line: str, calendar: Sequence[str]) -> tuple[int, float]:
    try:
        year, month, day, hour, minute = map(int, calendar[:5])
        if len(calendar[0]) == 2:
            year += 1900 if year >= 80 else 2000
        days = date(year, month, day).toordinal() - _FIRST_DAY
        return days, hour * 3600.0 + minute * 60.0 + float(calendar[5])
    except ValueError as error:
        raise LogError(
            f"{where}: no time in {line.rstrip()!r} ({error}); the file is damaged"
        ) from error


def _satellite(where: str, name: str) -> str:
    letter, number = name[:1].replace(" ", "G"), name[1:].replace(" ", "0")
    if letter.isalpha() and len(number) == 2 and number.isdecimal():
        return letter + number
    raise LogError(
        f"{where}: found {name!r} where a satellite such as G07 should stand; the file is damaged"
    )
