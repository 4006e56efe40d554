"""The door: what a drive log must be before anything is computed from it.

Each refusal names the file, the row (the first is 1, a header not counted), what was found and
what to do. What merely spoils a result, such as a frozen channel, is left to the quality checks.
"""

import math
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.columns import REQUIRED, TABLES
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.interval_means import FloatArray
from navlearn.logs.nearest import nearest_hint
from navlearn.logs.range_checks import check_range_metadata, checked_ranges

FASTEST_CAR: Final = 120.0
"""No road car drives faster, m/s."""

LATEST: Final = 1e11
"""No clock counts further in seconds: three thousand years."""

FASTEST_TURN: Final = 3.5
"""Hardly any sample of a driving car turns faster, rad/s (200 °/s)."""


TEXTS: Final = ("satellite",)
"""Columns that hold text."""


def validate_log(log: DriveLog) -> DriveLog:
    """Return the log, all columns float64, or refuse it.

    A car need not have an odometer, nor fixes of its own where there is a reference or there are
    raw ranges: then the table has its columns, but neither rows nor a file.

    Args:
        log: Drive to check.

    Returns:
        The same drive.

    Raises:
        LogError: A table is empty, a required column is missing or not finite, time does not
            increase, values cannot be in radians or SI units, or what is known of raw ranges
            cannot be.
    """
    check_range_metadata(log.metadata)
    tables = {name: _checked_table(log, name) for name in log.tables()}
    return log.with_tables(tables)


def label(log: DriveLog, table: str) -> str:
    """Return the name that messages give a table: its file, or the log's name and the table's.

    Args:
        log: Drive.
        table: Name of one of its tables.
    """
    files = log.metadata.extra.get("files")
    if isinstance(files, dict) and table in files:
        return str(files[table])
    return f"{log.metadata.source or log.metadata.name}: {table}"


def as_numbers(where: str, table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with every column float64 and finite or NaN, but those that are text.

    Args:
        where: Name of the table in messages.
        table: Table as read.

    Raises:
        LogError: A column holds something else than numbers, or infinity.
    """
    return pd.DataFrame(
        {
            str(column): table[column].astype("str")
            if column in TEXTS
            else _numbers(where, str(column), table)
            for column in table
        }
    )


def _checked_table(log: DriveLog, name: str) -> pd.DataFrame:
    where, table = label(log, name), log.tables()[name]
    _require_columns(where, name, table)
    if len(table) < _fewest_rows(log, name):
        raise LogError(
            f"{where}: found {len(table)} rows; a drive needs samples there; check that the file "
            "was written to its end"
        )
    numbers = as_numbers(where, table)
    if name == "ranges":
        return checked_ranges(where, numbers)
    _require_increasing_time(where, numbers["t"].to_numpy())
    for column in REQUIRED[name]:
        _require_finite(where, name, column, numbers)
    _refuse_wrong_units(where, name, numbers)
    return numbers


def _fewest_rows(log: DriveLog, name: str) -> int:
    if name == "ranges":
        return 0
    dispensable = name == "odometer" or (
        name == "fixes" and (log.reference is not None or log.ranges is not None)
    )
    if dispensable and log.tables()[name].empty:
        files = log.metadata.extra.get("files")
        return 1 if isinstance(files, dict) and name in files else 0
    return 1 if name == "fixes" else 2


def _require_columns(where: str, name: str, table: pd.DataFrame) -> None:
    for column in ("t", *REQUIRED[name]):
        if column not in table:
            found = ", ".join(map(str, table.columns)) or "no columns"
            known = [str(other) for other in table if other not in TABLES[name]]
            raise LogError(
                f"{where}: no column {column}{nearest_hint(column, known)}; found {found}; name "
                f"it {column} or map it in a descriptor"
            )


def _numbers(where: str, column: str, table: pd.DataFrame) -> FloatArray:
    try:
        values = table[column].to_numpy(np.float64, na_value=np.nan)
    except (TypeError, ValueError) as error:
        numeric = pd.to_numeric(table[column], errors="coerce")
        row = int(np.argmax((numeric.isna() & table[column].notna()).to_numpy()))
        raise LogError(
            f"{where}: column {column} holds {table[column].iloc[row]!r} at row {row + 1}, "
            "expected numbers; leave a missing value empty"
        ) from error
    infinite = np.isinf(values)
    if infinite.any():
        raise LogError(
            f"{where}: column {column} is infinite at row {int(np.argmax(infinite)) + 1} "
            f"({int(infinite.sum())} such rows); leave a missing value empty"
        )
    return values


def _require_increasing_time(where: str, t: FloatArray) -> None:
    if np.isnan(t).any():
        raise LogError(
            f"{where}: no time at row {int(np.argmax(np.isnan(t))) + 1} ({int(np.isnan(t).sum())} "
            "such rows); remove the rows or give them times"
        )
    beyond = np.abs(t) > LATEST
    if beyond.any():
        row = int(np.argmax(beyond))
        raise LogError(
            f"{where}: t is {t[row]:.6g} at row {row + 1}, no time in seconds; give its unit (ms, "
            "us, ns) in a descriptor"
        )
    step = np.diff(t)
    if (step > 0.0).all():
        return
    row = int(np.argmax(step <= 0.0)) + 1
    remedy = "sort the file or set on_backstep: drop in its descriptor"
    if step[row - 1] == 0.0:
        raise LogError(
            f"{where}: row {row + 1} repeats the time of row {row} ({t[row]:.6g} s; "
            f"{int((step == 0.0).sum())} such rows); keep one of them or set on_backstep: drop "
            "in its descriptor"
        )
    raise LogError(
        f"{where}: time steps back at row {row + 1} ({t[row]:.10g} s after {t[row - 1]:.10g} s; "
        f"{int((step < 0.0).sum())} such rows); {remedy}"
    )


def _require_finite(where: str, name: str, column: str, table: pd.DataFrame) -> None:
    missing = table[column].isna().to_numpy()
    if name == "fixes" and {"v_e", "v_n"} <= set(table):
        velocity_only = table[["lat", "lon"]].isna().all(axis=1) & table[
            ["v_e", "v_n"]
        ].notna().all(axis=1)
        missing = missing & ~velocity_only.to_numpy()
    if not missing.any():
        return
    first = int(np.argmax(missing))
    length = int(np.argmin(np.append(missing[first:], False)))
    t = table["t"].to_numpy()
    raise LogError(
        f"{where}: column {column} has no value in {length} rows from row {first + 1} "
        f"(t = {t[first]:.10g} to {t[first + length - 1]:.10g} s; {int(missing.sum())} rows in "
        "all); remove those rows (short gaps are bridged when resampling) or cut the log there"
    )


def _refuse_wrong_units(where: str, name: str, table: pd.DataFrame) -> None:
    if name in ("fixes", "reference"):
        _refuse_degrees(where, "lat", table["lat"].to_numpy(), math.pi / 2.0)
        _refuse_degrees(where, "lon", table["lon"].to_numpy(), 2.0 * math.pi)
    if name == "imu":
        _refuse_degrees_per_second(where, table["gyro_z"].to_numpy())
    if name == "odometer":
        _refuse_impossible_speed(where, table["speed"].to_numpy())


def _refuse_degrees(where: str, column: str, values: FloatArray, limit: float) -> None:
    beyond = np.abs(values) > limit + 1e-9
    if beyond.any():
        row = int(np.argmax(beyond))
        raise LogError(
            f"{where}: {column} is {values[row]:.8g} at row {row + 1}, expected radians within "
            f"±{limit:.4f}; if it is in degrees, name the column {column}_deg or give unit: deg "
            "in a descriptor"
        )


def _refuse_degrees_per_second(where: str, gyro: FloatArray) -> None:
    fast = float(np.quantile(np.abs(gyro), 0.99))
    if fast > FASTEST_TURN:
        raise LogError(
            f"{where}: gyro_z exceeds {fast:.3g} rad/s in 1 % of its rows, more than a car turns; "
            "if it is in degrees per second, name the column gyro_z_deg_per_s or give unit: "
            "deg/s in a descriptor"
        )


def _refuse_impossible_speed(where: str, speed: FloatArray) -> None:
    beyond = np.abs(speed) > FASTEST_CAR
    if beyond.any():
        row = int(np.argmax(beyond))
        raise LogError(
            f"{where}: speed is {speed[row]:.6g} m/s at row {row + 1} ({int(beyond.sum())} rows "
            f"above {FASTEST_CAR:g} m/s); if it is in km/h, name the column speed_kmh or give "
            "unit: km/h in a descriptor; else remove the rows"
        )
