"""Fixes from NMEA 0183 text, as receivers write it: GGA, RMC, GST, VTG and ZDA per epoch.

Sentences are taken apart by pynmeagps. Those of one UTC time make one fix: position, height and
satellites of GGA (or the position of RMC), velocity of RMC (or VTG), standard deviations of GST.
Heights are above the sea plus the receiver's own geoid separation: above the ellipsoid. A
sentence with a wrong checksum is counted and left out; so are epochs without a fix, and those
that the receiver estimated or was told by hand.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import date, time
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError, MissingExtraError
from navlearn.logs.formats.receiver import ReceiverLog, read_bytes

SENTENCES: Final = ("GGA", "RMC", "GST", "VTG", "ZDA")
_KNOT: Final = 1852.0 / 3600.0
_DAY: Final = 86400.0
_NO_FIX: Final = (0, 6, 7)
_NO_FIX_MODES: Final = ("N", "E", "M")


@dataclass
class _Epoch:
    """Sentences of one UTC time."""

    second: float = math.nan
    day: date | None = None
    sentences: dict[str, Any] = field(default_factory=dict)


def read_nmea(path: Path, *, with_separation: bool = True) -> ReceiverLog:
    """Return the fixes of an NMEA text.

    Args:
        path: File; bytes before a line's ``$`` are skipped, a trailing ``.gz`` is decompressed.
        with_separation: Whether the receiver's geoid separation is added to heights; False where
            a better one will be.

    Raises:
        MissingExtraError: pynmeagps is not installed.
        LogError: No sentence with a fix.
    """
    counts: Counter[str] = Counter()
    epochs = list(_epochs(_sentences(read_bytes(path), counts)))
    dated = _tell_days(epochs)
    rows = [row for epoch in epochs if (row := _fix(epoch, with_separation)) is not None]
    counts["epochs without a fix"] = sum(map(_tells_of_a_fix, epochs)) - len(rows)
    if not rows:
        found = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        raise LogError(
            f"{path.name}: no GGA or RMC sentence with a fix ({found or 'no sentence'}); is it "
            "NMEA text, of a receiver that saw the sky?"
        )
    table = pd.DataFrame(rows)
    return ReceiverLog(
        fixes=table.dropna(axis="columns", how="all"),
        dated=dated,
        notes={"format": "nmea", "time": "UTC", **{k: v for k, v in counts.items() if v}},
    )


def _parser() -> Any:
    try:
        from pynmeagps import NMEAReader
    except ImportError as error:
        raise MissingExtraError(
            "reading NMEA needs pynmeagps; pip install navlearn[gnss]"
        ) from error
    return NMEAReader.parse


def _sentences(content: bytes, counts: Counter[str]) -> Iterator[Any]:
    parse = _parser()
    for line in content.splitlines():
        begin = line.find(b"$")
        if begin < 0 or line[begin + 3 : begin + 6].decode("ascii", "replace") not in SENTENCES:
            continue
        try:
            sentence = parse(line[begin:].strip() + b"\r\n")
        except Exception as error:
            # The parser fails in many ways on a damaged line, built-in errors among them.
            kind = "checksum errors" if "checksum" in str(error) else "damaged sentences"
            counts[kind] += 1
            continue
        if sentence is None:
            counts["damaged sentences"] += 1
        else:
            yield sentence


def _epochs(sentences: Iterator[Any]) -> Iterator[_Epoch]:
    epoch, ahead = _Epoch(), None
    for sentence in sentences:
        kind = sentence.msgID
        if kind == "VTG":
            # It tells no time: the second of an epoch belongs to the epoch that follows.
            if "VTG" in epoch.sentences or math.isnan(epoch.second):
                ahead = sentence
            else:
                epoch.sentences["VTG"] = sentence
            continue
        second = _second(sentence)
        if second is None:
            continue
        if second != epoch.second:
            if not math.isnan(epoch.second):
                yield epoch
            epoch = _Epoch(second=second, sentences={} if ahead is None else {"VTG": ahead})
            ahead = None
        epoch.sentences.setdefault(kind, sentence)
        epoch.day = epoch.day or _date(sentence)
    if not math.isnan(epoch.second):
        yield epoch


def _second(sentence: Any) -> float | None:
    told = sentence.time
    if not isinstance(told, time):
        return None
    return told.hour * 3600.0 + told.minute * 60.0 + told.second + told.microsecond * 1e-6


def _date(sentence: Any) -> date | None:
    if sentence.msgID == "RMC":
        return sentence.date if isinstance(sentence.date, date) else None
    if sentence.msgID == "ZDA":
        try:
            return date(int(sentence.year), int(sentence.month), int(sentence.day))
        except (TypeError, ValueError):
            return None
    return None


def _tell_days(epochs: list[_Epoch]) -> bool:
    """Give every epoch its day: midnight passes where the time of day falls back by half a day."""
    wraps = [0]
    for before, after in pairwise(epochs):
        wraps.append(wraps[-1] + (after.second < before.second - 0.5 * _DAY))
    known = [(i, epoch.day) for i, epoch in enumerate(epochs) if epoch.day is not None]
    anchor = known[0] if known else (0, date(1970, 1, 1))
    for i, epoch in enumerate(epochs):
        if epoch.day is not None:
            anchor = (i, epoch.day)
        day = anchor[1].toordinal() + wraps[i] - wraps[anchor[0]]
        epoch.day = date.fromordinal(day)
    return bool(known)


def _tells_of_a_fix(epoch: _Epoch) -> bool:
    return bool({"GGA", "RMC"} & set(epoch.sentences))


def _fix(epoch: _Epoch, with_separation: bool) -> dict[str, float] | None:
    gga, rmc = epoch.sentences.get("GGA"), epoch.sentences.get("RMC")
    if gga is not None and gga.quality in _NO_FIX:
        return None
    if rmc is not None and (rmc.status != "A" or getattr(rmc, "posMode", "") in _NO_FIX_MODES):
        rmc = None
        if gga is None:
            return None
    source = gga if gga is not None and _number(gga.lat) is not None else rmc
    if source is None or _number(source.lat) is None or epoch.day is None:
        return None
    v_e, v_n = _velocity(rmc, epoch.sentences.get("VTG"))
    gst = epoch.sentences.get("GST")
    return {
        "t": (epoch.day.toordinal() - date(1970, 1, 1).toordinal()) * _DAY + epoch.second,
        "lat": math.radians(_or_nan(source, "lat")),
        "lon": math.radians(_or_nan(source, "lon")),
        "height": _height(gga, with_separation),
        "v_e": v_e,
        "v_n": v_n,
        "std_e": _or_nan(gst, "stdLong"),
        "std_n": _or_nan(gst, "stdLat"),
        "std_u": _or_nan(gst, "stdAlt"),
        "satellites": _or_nan(gga, "numSV"),
    }


def _velocity(rmc: Any, vtg: Any) -> tuple[float, float]:
    speed, course = _or_nan(rmc, "spd"), _or_nan(rmc, "cog")
    if math.isnan(speed) and getattr(vtg, "posMode", "") not in _NO_FIX_MODES:
        speed, course = _or_nan(vtg, "sogn"), _or_nan(vtg, "cogt")
    if speed == 0.0:
        return 0.0, 0.0
    # Receivers leave the course empty at a crawl: the direction is not known.
    speed, course = speed * _KNOT, math.radians(course)
    return speed * math.sin(course), speed * math.cos(course)


def _height(gga: Any, with_separation: bool) -> float:
    over_sea, separation = _or_nan(gga, "alt"), _or_nan(gga, "sep")
    if with_separation and not math.isnan(separation):
        return over_sea + separation
    return over_sea


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else None


def _or_nan(sentence: Any, name: str) -> float:
    found = _number(getattr(sentence, name, None))
    return math.nan if found is None else found
