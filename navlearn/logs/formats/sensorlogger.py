"""Drives recorded with a phone and the app Sensor Logger: its CSV files, or one file of them all.

The app writes a folder with ``Gyroscope.csv``, ``Location.csv`` and either
``TotalAcceleration.csv`` or ``Accelerometer.csv`` (without gravity) and ``Gravity.csv``; times in
nanoseconds since 1970. Others publish the sensors side by side in one file, averaged over equal
intervals that *begin* at their stamps. A phone's axes are x right, y up, z out of its screen.
Accelerations of an iPhone have the other sign unless the app's frames were standardised: turns of
fixes against gyros tell.

How the phone stands in the car is found from the drive (:mod:`navlearn.logs.phone_mounting`)
unless the descriptor states ``axes``. Where nothing tells its angle about the vertical, only the
gyro about the vertical and the vertical specific force are kept, with a warning.

A phone has no odometer. Speed of its own fixes is none: it ends where they end.
"""

import warnings
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.assemble import Published
from navlearn.logs.axes import turned
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.formats.csv_tables import read_frame
from navlearn.logs.formats.finding import listing
from navlearn.logs.formats.phone_columns import (
    numbers,
    phone_fixes,
    require_columns,
    seconds,
)
from navlearn.logs.interval_means import FloatArray, typical_period
from navlearn.logs.phone_mounting import PhoneMounting, find_mounting

_AXES: Final = ("x", "y", "z")
_GYROS: Final = tuple(f"gyro_{axis}" for axis in _AXES)
_FORCES: Final = tuple(f"accel_{axis}" for axis in _AXES)
_PLACE: Final = ("latitude", "longitude")
_MERGED: Final = ("time", *_PLACE, *_GYROS)
_LEAST_GRAVITY: Final = 5.0
_MARGIN: Final = 2.0


def read_sensorlogger(path: Path, descriptor: Descriptor) -> Published:
    """Return IMU and fixes of a drive recorded with a phone.

    Args:
        path: The app's folder, or one file of all sensors.
        descriptor: Where it states ``axes``, the phone's mounting is taken from it.

    Returns:
        IMU and fixes; ``extra["mounting"]`` tells what was found, in a descriptor's words.

    Raises:
        LogNotFoundError: A file is missing.
        LogError: A file or a column is not usable, or gravity is not told.
    """
    merged = path.is_file()
    imu, fixes, files = _merged(path) if merged else _folder(path)
    told = len(fixes)
    fixes = _of_this_drive(imu, fixes)
    if len(imu) < 2 or fixes.empty:
        raise LogError(
            f"{files['imu']}: {len(imu)} rows with gyro and acceleration, {len(fixes)} with a fix; "
            "check that the file was written to its end"
        )
    extra: dict[str, object] = {"stale_fixes": told - len(fixes)} if told > len(fixes) else {}
    if descriptor.axes is None:
        mounting = find_mounting(imu, fixes)
        extra["mounting"] = mounting.in_words()
        imu = _mounted(imu, mounting, path)
        sign = mounting.turn_sign
    else:
        # In a car that stands on its wheels what is stated to be up reads gravity's reaction.
        up = descriptor.body_from_sensor("RFU")[2]
        sign = -1 if float(up @ imu[list(_FORCES)].median().to_numpy()) < 0.0 else 1
        imu = _signed(imu, sign)
    if sign < 0:
        extra["acceleration_sign"] = "turned, as an iPhone's"
    return Published(
        tables={"imu": imu, "fixes": fixes},
        files=files,
        source=f"sensorlogger: {path}",
        time_scale="UTC, s since 1970",
        interval_means=("imu",) if merged else (),
        extra=extra,
    )


def is_sensorlogger(path: Path) -> bool:
    """Tell whether a file or folder is a drive recorded with Sensor Logger.

    Args:
        path: File or folder.
    """
    if path.is_dir():
        return all((path / f"{name}.csv").is_file() for name in ("Gyroscope", "Location"))
    if not path.name.lower().endswith((".csv", ".csv.gz")):
        return False
    try:
        header = set(map(str, pd.read_csv(path, nrows=0).columns))
    except (OSError, EOFError, ValueError):
        return False
    return set(_MERGED) <= header


def _merged(path: Path) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, str]]:
    frame = read_frame(path)
    require_columns(path, frame, _MERGED)
    t = seconds(path, frame["time"])
    period = typical_period(t)
    rates = {name: numbers(path, frame, name) for name in _GYROS}
    force = _force(
        path,
        *(
            {axis: numbers(path, frame, f"{kind}_{axis}") for axis in _AXES}
            if f"{kind}_x" in frame
            else None
            for kind in ("acc", "grav")
        ),
    )
    # A mean over the interval that begins at its stamp; a fix lies anywhere in it.
    imu = pd.DataFrame({"t": t + period, **rates, **force}).dropna(ignore_index=True)
    fixes = phone_fixes(path, frame, t + 0.5 * period)
    return imu, fixes, dict.fromkeys(("imu", "fixes"), path.name)


def _folder(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, str]]:
    gyro, location = _file(folder, "Gyroscope"), _file(folder, "Location")
    t = seconds(folder / "Gyroscope.csv", gyro["time"])
    rates = {f"gyro_{axis}": numbers(folder / "Gyroscope.csv", gyro, axis) for axis in _AXES}
    total = (folder / "TotalAcceleration.csv").is_file()
    names = ("TotalAcceleration",) if total else ("Accelerometer", "Gravity")
    parts = [_at(folder, name, t) if (folder / f"{name}.csv").is_file() else None for name in names]
    force = _force(folder / f"{names[0]}.csv", parts[0], parts[1] if len(parts) > 1 else None)
    imu = pd.DataFrame({"t": t, **rates, **force}).dropna(ignore_index=True)
    path = folder / "Location.csv"
    fixes = phone_fixes(path, location, seconds(path, location["time"]))
    return imu, fixes, {"imu": "Gyroscope.csv", "fixes": "Location.csv"}


def _file(folder: Path, name: str) -> pd.DataFrame:
    path = folder / f"{name}.csv"
    if not path.is_file():
        raise LogNotFoundError(
            f"{path}: no such file, which the app writes; found {listing(folder)}"
        )
    frame = read_frame(path)
    require_columns(path, frame, ("time", *(_PLACE if name == "Location" else _AXES)))
    return frame


def _at(folder: Path, name: str, t: FloatArray) -> dict[str, FloatArray]:
    frame, path = _file(folder, name), folder / f"{name}.csv"
    known = seconds(path, frame["time"])
    return {
        axis: np.interp(t, known, numbers(path, frame, axis), left=np.nan, right=np.nan)
        for axis in _AXES
    }


def _force(
    path: Path, acc: dict[str, FloatArray] | None, gravity: dict[str, FloatArray] | None
) -> dict[str, FloatArray]:
    """Return the specific force: with gravity as it is, without it and gravity added."""
    if acc is None or any(np.isnan(values).all() for values in acc.values()):
        raise LogError(
            f"{path.name}: no acceleration; a phone's mounting cannot be found without: record "
            "TotalAcceleration, or Accelerometer and Gravity"
        )
    size = float(np.linalg.norm([np.nanmedian(values) for values in acc.values()]))
    if size < _LEAST_GRAVITY and gravity is None:
        raise LogError(
            f"{path.name}: mean acceleration of {size:.2f} m/s² is without gravity, and there is "
            "no gravity beside it; record Gravity or TotalAcceleration too"
        )
    if size >= _LEAST_GRAVITY or gravity is None:
        return {f"accel_{axis}": acc[axis] for axis in _AXES}
    return {f"accel_{axis}": acc[axis] + gravity[axis] for axis in _AXES}


def _of_this_drive(imu: pd.DataFrame, fixes: pd.DataFrame) -> pd.DataFrame:
    """Return the fixes without those that a phone had in store, or tells twice."""
    if imu.empty:
        return fixes
    first, last = imu["t"].iloc[0] - _MARGIN, imu["t"].iloc[-1] + _MARGIN
    fixes = fixes[fixes["t"].between(first, last) | fixes["t"].isna()]
    return fixes[~fixes["t"].duplicated()].reset_index(drop=True)


def _mounted(imu: pd.DataFrame, mounting: PhoneMounting, path: Path) -> pd.DataFrame:
    level = turned(_signed(imu, mounting.turn_sign), mounting.matrix)
    if mounting.yaw_std is not None:
        return level
    warnings.warn(
        f"{path.name}: how the phone is turned about the vertical is not known (too little motion, "
        "or it was moved); only the gyro about the vertical and the vertical specific force are "
        "kept; state axes and mounting in a descriptor to have the others",
        stacklevel=2,
    )
    return level[["t", "gyro_z", "accel_z"]]


def _signed(imu: pd.DataFrame, sign: int) -> pd.DataFrame:
    return imu.assign(**{name: sign * imu[name] for name in _FORCES})
