"""Fixes from u-blox binary files: the NAV-PVT messages.

Messages are taken apart by pyubx2. Epochs lie on the receiver's GPS time of week, in whole
milliseconds; UTC, which lacks the leap seconds, is taken from the messages that have it fully
resolved and carried through the others. Fixes by dead reckoning alone are left out, so is the
height of a two-dimensional fix.
"""

import io
import math
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError, MissingExtraError
from navlearn.gnss.gnss_time import WEEK
from navlearn.logs.formats.receiver import ReceiverLog, read_bytes
from navlearn.logs.interval_means import FloatArray

_NAV_PVT: Final = b"\x01\x07"
_FIX_2D, _FIX_3D, _FIX_WITH_DEAD_RECKONING = 2, 3, 4
_UBX_ONLY: Final = 2
_MM: Final = 1e-3


def read_ubx(path: Path) -> ReceiverLog:
    """Return the fixes of a u-blox file.

    Accuracies of the message are taken as standard deviations: the horizontal one, which is that
    of the radius, for east and north each, so they are rather too large than too small.

    Args:
        path: File; other messages and NMEA between them are skipped, a trailing ``.gz`` is
            decompressed.

    Raises:
        MissingExtraError: pyubx2 is not installed.
        LogError: No NAV-PVT message with a fix, or none with a date.
    """
    counts: Counter[str] = Counter()
    messages = list(_messages(read_bytes(path), counts))
    fixed = np.array([_is_fix(message) for message in messages], dtype=bool)
    if not fixed.any():
        found = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        raise LogError(
            f"{path.name}: no NAV-PVT message with a fix (found {len(messages)} of them"
            f"{', ' + found if found else ''}); is it a u-blox file, and NAV-PVT switched on?"
        )
    t, leap_seconds_known = _times(path.name, messages)
    table = pd.DataFrame([_fix(message) for message in messages])
    counts["epochs without a fix"] = int((~fixed).sum())
    return ReceiverLog(
        fixes=table.assign(t=t)[fixed].reset_index(drop=True),
        notes={
            "format": "ubx",
            "time": "UTC, epochs of GPS time of week",
            "leap_seconds_known": leap_seconds_known,
            **{what: count for what, count in counts.items() if count},
        },
    )


def _reader() -> Any:
    try:
        from pyubx2 import UBXReader
    except ImportError as error:
        raise MissingExtraError(
            "reading u-blox files needs pyubx2; pip install navlearn[gnss]"
        ) from error
    return UBXReader


def _messages(content: bytes, counts: Counter[str]) -> Iterator[Any]:
    reader = _reader()
    found = reader(io.BytesIO(content), protfilter=_UBX_ONLY, quitonerror=0, parsing=False)
    for raw, _ in found:
        if raw[2:4] != _NAV_PVT:
            continue
        try:
            yield reader.parse(raw)
        except Exception as error:
            # The parser fails in many ways on a damaged message.
            kind = "checksum errors" if "checksum" in str(error) else "damaged messages"
            counts[kind] += 1


def _is_fix(message: Any) -> bool:
    kinds = (_FIX_2D, _FIX_3D, _FIX_WITH_DEAD_RECKONING)
    return bool(message.gnssFixOk and message.fixType in kinds)


def _times(file: str, messages: list[Any]) -> tuple[FloatArray, bool]:
    week_seconds = np.array([message.iTOW for message in messages]) * 1e-3
    # A new week begins where the time of week falls back by half of one.
    weeks = np.cumsum(np.diff(week_seconds, prepend=week_seconds[0]) < -0.5 * WEEK)
    since = week_seconds + weeks * WEEK
    utc = np.array([_utc(message) for message in messages])
    resolved = np.array([bool(message.fullyResolved) for message in messages])
    known = np.isfinite(utc)
    if not known.any():
        raise LogError(
            f"{file}: none of {len(messages)} NAV-PVT messages has a valid UTC date; record until "
            "the receiver knows it"
        )
    leap_seconds_known = bool((known & resolved).any())
    usable = known & resolved if leap_seconds_known else known
    # Epochs are whole milliseconds of GPS time; the message's UTC tells the clock's error too.
    offset = round(float(np.median((utc - since)[usable])))
    return since + offset, leap_seconds_known


def _utc(message: Any) -> float:
    if not (message.validDate and message.validTime):
        return math.nan
    try:
        day = datetime(message.year, message.month, message.day, tzinfo=UTC).timestamp()
    except ValueError:
        return math.nan
    seconds = 3600.0 * message.hour + 60.0 * message.min + message.second + 1e-9 * message.nano
    return day + float(seconds)


def _fix(message: Any) -> dict[str, float]:
    return {
        "t": math.nan,
        "lat": math.radians(message.lat),
        "lon": math.radians(message.lon),
        "height": math.nan if message.fixType == _FIX_2D else message.height * _MM,
        "v_e": message.velE * _MM,
        "v_n": message.velN * _MM,
        "v_u": -message.velD * _MM,
        "std_e": message.hAcc * _MM,
        "std_n": message.hAcc * _MM,
        "std_u": message.vAcc * _MM,
        "std_v": message.sAcc * _MM,
        "satellites": float(message.numSV),
    }
