"""Columns of a phone's CSV files: times, numbers, fixes."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.interval_means import FloatArray

_ACCURACIES: Final = {
    "std_e": "horizontalAccuracy",
    "std_n": "horizontalAccuracy",
    "std_u": "verticalAccuracy",
    "std_v": "speedAccuracy",
}
_STANDING: Final = 0.1


def phone_fixes(path: Path, frame: pd.DataFrame, t: FloatArray) -> pd.DataFrame:
    """Return a phone's fixes: what it says is not known, or of no accuracy, is missing.

    Args:
        path: File, for messages.
        frame: Columns ``latitude``, ``longitude`` and what else the phone tells.
        t: Times of its rows, s, shape (N,).

    Raises:
        LogError: A column holds something else than numbers.
    """

    def valid(name: str) -> FloatArray:
        if name not in frame:
            return np.full(t.size, np.nan)
        values = numbers(path, frame, name)
        # Below zero says that it is not known, an accuracy of zero too.
        least = np.nextafter(0.0, 1.0) if name.endswith("Accuracy") else 0.0
        return np.where(values >= least, values, np.nan)

    speed, bearing = valid("speed"), np.radians(valid("bearing"))
    # A phone without a course says 0 and no accuracy; standing it needs none.
    unknown = np.isnan(bearing) | ((bearing == 0.0) & np.isnan(valid("bearingAccuracy")))
    bearing = np.where(unknown, np.where(speed < _STANDING, 0.0, np.nan), bearing)
    columns = {
        "t": t,
        "lat": np.radians(numbers(path, frame, "latitude")),
        "lon": np.radians(numbers(path, frame, "longitude")),
        "height": numbers(path, frame, "altitude") if "altitude" in frame else np.nan,
        "v_e": speed * np.sin(bearing),
        "v_n": speed * np.cos(bearing),
        **{name: valid(source) for name, source in _ACCURACIES.items()},
    }
    return pd.DataFrame(columns).dropna(axis="columns", how="all")


def require_columns(path: Path, frame: pd.DataFrame, names: tuple[str, ...]) -> None:
    """Refuse a table that lacks a column.

    Args:
        path: File, for messages.
        frame: Table as read.
        names: Columns that it must have.

    Raises:
        LogError: One is missing.
    """
    missing = [name for name in names if name not in frame]
    if missing:
        found = ", ".join(map(str, frame.columns))
        raise LogError(f"{path.name}: no column {', '.join(missing)}; found {found}")


def numbers(path: Path, frame: pd.DataFrame, name: str) -> FloatArray:
    """Return a column as float64, NaN where it is empty.

    Args:
        path: File, for messages.
        frame: Table as read.
        name: Column.

    Raises:
        LogError: It is missing, or holds something else than numbers.
    """
    require_columns(path, frame, (name,))
    values = pd.to_numeric(frame[name], errors="coerce")
    wrong = (values.isna() & frame[name].notna()).to_numpy()
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{path.name}: column {name} holds {frame[name].iloc[row]!r} at row {row + 1}, "
            "expected numbers; leave a missing value empty"
        )
    return np.asarray(values, dtype=np.float64)


def seconds(path: Path, column: pd.Series) -> FloatArray:
    """Return times in seconds since 1970.

    Args:
        path: File, for messages.
        column: Nanoseconds since 1970, or text with a time zone.

    Raises:
        LogError: A text is no time.
    """
    if pd.api.types.is_numeric_dtype(column):
        return np.asarray(column, dtype=np.float64) / 1e9
    stamps = pd.to_datetime(column, format="ISO8601", utc=True, errors="coerce")
    if stamps.isna().any():
        row = int(np.argmax(stamps.isna().to_numpy()))
        raise LogError(
            f"{path.name}: time is {column.iloc[row]!r} at row {row + 1}, expected a time such as "
            "2023-08-09 16:37:45+00:00, or nanoseconds since 1970"
        )
    microseconds = stamps.dt.tz_convert(None).to_numpy("datetime64[us]").astype(np.int64)
    return np.asarray(microseconds / 1e6, dtype=np.float64)
