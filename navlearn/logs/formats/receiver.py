"""What a receiver's own file gives to a log of plain tables: its fixes, on the log's clock."""

import gzip
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.table_layout import Table


@dataclass(frozen=True, kw_only=True)
class ReceiverLog:
    """Fixes of a receiver's file.

    Attributes:
        fixes: Columns of :data:`navlearn.logs.columns.FIXES`, ``t`` in UTC seconds since 1970.
        dated: Whether the file told the date; without it ``t`` counts from a midnight.
        notes: What was counted and left out, for the log's metadata.
    """

    fixes: pd.DataFrame
    dated: bool = True
    notes: Mapping[str, object] = field(default_factory=dict)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file, decompressed where it ends in ``.gz``.

    Args:
        path: File.

    Raises:
        LogError: It cannot be decompressed.
    """
    if path.suffix != ".gz":
        return path.read_bytes()
    try:
        return gzip.decompress(path.read_bytes())
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(f"{path.name}: not readable as gzip ({error}); it is truncated") from error


def on_the_logs_clock(receiver: ReceiverLog, layout: Table) -> pd.DataFrame:
    """Return the fixes with their times on the clock of the log's other tables.

    That clock is UTC in seconds since 1970, or reads zero at the layout's ``clock_start``. GPS
    seconds of week begin, in UTC, so many leap seconds before midnight of Saturday to Sunday.

    Args:
        receiver: What the file gave.
        layout: The descriptor's words on the table.

    Raises:
        LogError: The file has no date, and the layout no ``clock_start`` to take it from.
    """
    t = receiver.fixes["t"].to_numpy(np.float64)
    if layout.clock_start is None:
        if not receiver.dated:
            raise LogError(
                f"{layout.file}: no sentence tells the date (RMC or ZDA would); state clock_start "
                "of the table: the UTC at which the other tables' clock read zero"
            )
        return receiver.fixes
    start = layout.clock_start.timestamp()
    if not receiver.dated:
        # The first fix came within twelve hours of the clock's start.
        t = t + 86400.0 * round((start - t[0]) / 86400.0)
    return receiver.fixes.assign(t=t - start)


def refuse_other_clock(file: str, name: str, found: pd.DataFrame, imu: pd.DataFrame) -> None:
    """Refuse fixes or ranges of which none lies within the time of the inertial samples.

    Args:
        file: File of the receiver, for the message.
        name: Table that it gave, for the message.
        found: What it gave, on the log's clock.
        imu: Inertial samples.

    Raises:
        LogError: They have no time in common.
    """
    # What is no time at all is left to the check of the table.
    t = pd.to_numeric(imu["t"], errors="coerce").dropna() if "t" in imu else pd.Series(dtype=float)
    if found.empty or t.empty:
        return
    first, last = float(found["t"].min()), float(found["t"].max())
    begin, end = float(t.min()), float(t.max())
    if first <= end and begin <= last:
        return
    raise LogError(
        f"{file}: {name} from {_told(first)} to {_told(last)}, IMU from {_told(begin)} to "
        f"{_told(end)}: no time in common; state clock_start of the table: the UTC at which the "
        "IMU's clock read zero (left out where it counts UTC seconds since 1970)"
    )


def _told(t: float) -> str:
    if 1e9 < t < 4e9:
        return f"{datetime.fromtimestamp(t, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return f"{t:.2f} s"
