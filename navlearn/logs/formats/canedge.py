"""Drives recorded by CSS Electronics' CANedge with a CANmod.gps: MDF4 files of CAN frames.

The CANmod.gps messages are decoded by the ``.dbc`` beside the files; the car's answers to OBD-II
requests (SAE J1979, service 1, PID 0x0D: speed in whole km/h) need none. Several files make one
drive. GNSS messages reach the bus with a jitter of tens of milliseconds while their epoch is
exact, so fixes are placed by their epoch (:mod:`navlearn.logs.formats.epochs`).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from navlearn.errors import LogError, LogNotFoundError, MissingExtraError
from navlearn.logs.assemble import Published, without_empty_fixes
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.formats.epochs import clock_from_epochs, rows_of_epochs
from navlearn.logs.formats.finding import listing
from navlearn.logs.formats.mdf4 import refuse_truncated
from navlearn.logs.interval_means import FloatArray

PUBLISHED_AXES: Final = "UBR"
"""Where x, y and z of the CANmod.gps point in CSS Electronics' published drives."""

_IMU: Final = {
    "gyro_x": ("AngularRateX", np.pi / 180.0),
    "gyro_y": ("AngularRateY", np.pi / 180.0),
    "gyro_z": ("AngularRateZ", np.pi / 180.0),
    "accel_x": ("AccelerationX", 1.0),
    "accel_y": ("AccelerationY", 1.0),
    "accel_z": ("AccelerationZ", 1.0),
}
_FIX_SIGNALS: Final = {
    "PositionValid": ("Latitude", "Longitude", "PositionAccuracy"),
    "AltitudeValid": ("Altitude", "AltitudeAccuracy"),
    "SpeedValid": ("Speed", "SpeedAccuracy"),
    "AttitudeValid": ("Heading",),
}
_OBD_ANSWERS: Final = (0x7E8, 0x7EF)
_OBD_SERVICE_1, _OBD_SPEED = 0x41, 0x0D


def read_canedge(folder: Path, descriptor: Descriptor) -> Published:
    """Return the tables of a CANedge drive.

    Args:
        folder: A folder at or above the ``.MF4`` files, or one such file.
        descriptor: Not asked here; the same for every format.

    Returns:
        IMU, odometer and fixes, in the sensor's axes.

    Raises:
        MissingExtraError: asammdf is not installed.
        LogNotFoundError: No ``.MF4`` or no ``.dbc`` file.
        LogError: A file is damaged, or a message the drive needs is not in it.
    """
    del descriptor
    files, dbc = _files(folder)
    parts = [_decode(file, dbc) for file in files]
    imu = _joined(parts, "imu")
    fixes, extra = _fixes(_joined(parts, "gnss"))
    odometer = _joined(parts, "odometer")
    for name, table, what in (
        ("imu", imu, "valid CANmod.gps IMU message"),
        ("fixes", fixes, "valid GNSS position"),
        ("odometer", odometer, "OBD-II answer to PID 0x0D (speed)"),
    ):
        if table.empty:
            raise LogError(f"{folder}: no {what} in {len(files)} file(s); {name} would be empty")
    names = f"{files[0].name}" if len(files) == 1 else f"{files[0].name} … {files[-1].name}"
    return Published(
        tables={"imu": imu, "odometer": odometer, "fixes": fixes},
        files=dict.fromkeys(("imu", "odometer", "fixes"), names),
        source=f"canedge: {folder}",
        axes=PUBLISHED_AXES,
        time_scale="logger's clock, s from the start of the first file",
        extra=extra,
    )


def _files(folder: Path) -> tuple[list[Path], Path]:
    home = folder if folder.is_dir() else folder.parent
    found = [folder] if folder.is_file() else sorted(home.rglob("*.[mM][fF]4"))
    if not found:
        raise LogNotFoundError(f"{folder}: no .MF4 file in or below it; found {listing(home)}")
    if len({file.parent for file in found}) > 1:
        homes = ", ".join(sorted({str(file.parent) for file in found})[:3])
        raise LogError(f"{folder}: several drives below it ({homes}); name the folder of one")
    dictionaries = sorted(found[0].parent.glob("*.dbc"))
    if len(dictionaries) != 1:
        raise LogNotFoundError(
            f"{found[0].parent}: {len(dictionaries)} .dbc files beside {found[0].name}; exactly "
            f"one is needed to decode the CANmod.gps; found {listing(found[0].parent)}"
        )
    return found, dictionaries[0]


def _asammdf() -> Any:
    try:
        import asammdf
    except ImportError as error:
        raise MissingExtraError(
            "reading .MF4 files needs asammdf; pip install navlearn[canedge]"
        ) from error
    return asammdf


def _decode(file: Path, dbc: Path) -> dict[str, pd.DataFrame]:
    asammdf = _asammdf()
    refuse_truncated(file)
    try:
        with asammdf.MDF(file) as raw:
            start = raw.header.start_time.timestamp()
            frames = raw.get("CAN_DataFrame", group=0)
            with raw.extract_bus_logging({"CAN": [(dbc, 0)]}) as decoded:
                tables = {"imu": _imu(decoded), "gnss": _gnss(decoded)}
        tables["odometer"] = _odometer(frames)
    except Exception as error:
        # A damaged file makes asammdf fail in many ways, private classes among them.
        raise LogError(
            f"{file.name}: not readable as MDF4 with CAN frames decoded by {dbc.name} "
            f"({type(error).__name__}: {error}); it is truncated or of another make"
        ) from error
    return {name: table.assign(start=start) for name, table in tables.items()}


def _joined(parts: list[dict[str, pd.DataFrame]], name: str) -> pd.DataFrame:
    filled = [part[name] for part in parts if len(part[name])]
    if not filled:
        return parts[0][name].drop(columns="start")
    table = pd.concat(filled, ignore_index=True)
    first = min(float(part[name]["start"].min()) for part in parts if len(part[name]))
    return table.assign(t=table["t"] + (table["start"] - first)).drop(columns="start")


def _signals(decoded: Any, names: Sequence[str], *, raw: bool = False) -> pd.DataFrame:
    # A short file may lack a message that comes once a second.
    if any(name not in decoded for name in names):
        return pd.DataFrame(columns=["t", *names], dtype=np.float64)
    found = {name: decoded.get(name, raw=raw) for name in names}
    t = next(iter(found.values())).timestamps
    return pd.DataFrame(
        {"t": t, **{name: signal.samples.astype(np.float64) for name, signal in found.items()}}
    )


def _imu(decoded: Any) -> pd.DataFrame:
    values = _signals(decoded, [signal for signal, _ in _IMU.values()])
    columns = {name: values[signal] * factor for name, (signal, factor) in _IMU.items()}
    table = pd.DataFrame({"t": values["t"], **columns})
    valid = _signals(decoded, ["ImuValid"], raw=True)["ImuValid"] == 1.0
    return table[valid].reset_index(drop=True)


def _gnss(decoded: Any) -> pd.DataFrame:
    epochs = _signals(decoded, ["Epoch"])
    table = epochs.rename(columns={"Epoch": "epoch"})
    for flag, signals in _FIX_SIGNALS.items():
        values = _signals(decoded, signals)
        valid = _signals(decoded, [flag], raw=True)[flag] == 1.0
        rows = rows_of_epochs(epochs["t"].to_numpy(), values["t"].to_numpy())
        for signal in signals:
            known = values[signal].where(valid).to_numpy()
            table[signal] = _picked(known, rows)
    satellites = _signals(decoded, ["Satellites"])
    rows = rows_of_epochs(epochs["t"].to_numpy(), satellites["t"].to_numpy())
    table["satellites"] = _picked(satellites["Satellites"].to_numpy(), rows)
    return table


def _picked(values: FloatArray, rows: npt.NDArray[np.int64]) -> FloatArray:
    padded = np.append(values, np.nan)
    return np.where(rows >= 0, padded[rows], np.nan)


def _odometer(frames: Any) -> pd.DataFrame:
    identifiers = frames.samples["CAN_DataFrame.ID"] & 0x1FFFFFFF
    data = frames.samples["CAN_DataFrame.DataBytes"]
    answer = (identifiers >= _OBD_ANSWERS[0]) & (identifiers <= _OBD_ANSWERS[1])
    speed = answer & (data[:, 1] == _OBD_SERVICE_1) & (data[:, 2] == _OBD_SPEED)
    return pd.DataFrame(
        {"t": frames.timestamps[speed], "speed": data[speed, 3].astype(np.float64) / 3.6}
    )


def _fixes(gnss: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, object]]:
    course = np.radians(gnss["Heading"])
    fixes = pd.DataFrame(
        {
            "t": gnss["t"],
            "epoch": gnss["epoch"],
            "lat": np.radians(gnss["Latitude"]),
            "lon": np.radians(gnss["Longitude"]),
            "height": gnss["Altitude"],
            "v_e": gnss["Speed"] * np.sin(course),
            "v_n": gnss["Speed"] * np.cos(course),
            "std_e": gnss["PositionAccuracy"],
            "std_n": gnss["PositionAccuracy"],
            "std_u": gnss["AltitudeAccuracy"],
            "std_v": gnss["SpeedAccuracy"],
            "satellites": gnss["satellites"],
        }
    )
    fixes = without_empty_fixes(fixes)
    if fixes.empty:
        return fixes.drop(columns="epoch"), {}
    t, drift = clock_from_epochs(fixes["epoch"].to_numpy(), fixes["t"].to_numpy())
    return fixes.assign(t=t).drop(columns="epoch"), {"gnss_clock_drift_ppm": round(drift * 1e6, 3)}
