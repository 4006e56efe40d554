"""Drives as the NavINST laboratory publishes them: a tree of MATLAB files.

``f_w_IMSseconds_dt.mat`` holds the IMU (already x right, y forward, z up), a CarChip file the
OBD-II speed, ``BESTGPSPOS`` and ``BESTGPSVEL`` the NovAtel fixes, ``INSPVA`` the reference;
``Raw_Data_combined`` and files beside it raw ranges (:mod:`.navinst_ranges`).
All are on GPS seconds of week. BESTGPSPOS heights are above mean sea level, INSPVA heights above
the ellipsoid. IMU samples are means over the interval that ends at their time: read as instants,
they lag the reference's azimuth by 0.050 s, half their spacing.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.assemble import Published
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.formats.finding import listing
from navlearn.logs.formats.navinst_files import find_one, load_variables, table_of, vector
from navlearn.logs.formats.navinst_ranges import read_navinst_ranges

KINGSTON_GEOID_HEIGHT: Final = -35.2
"""Geoid above the ellipsoid around Kingston, Ontario, where the laboratory drives, m."""

PATTERNS: Final[dict[str, str]] = {
    "imu": "f_w_IMSseconds_dt.mat",
    "odometer": "CarChip_Speed_interpolated.mat",
    "positions": "BESTGPSPOS.mat",
    "velocities": "BESTGPSVEL.mat",
    "reference": "INSPVA.mat",
}

_REFERENCE: Final[dict[str, tuple[str, float]]] = {
    "t": ("INS_second", 1.0),
    "lat": ("INS_Lat", np.pi / 180.0),
    "lon": ("INS_Long", np.pi / 180.0),
    "height": ("INS_Alt", 1.0),
    "v_e": ("INS_ve", 1.0),
    "v_n": ("INS_vn", 1.0),
    "v_u": ("INS_vu", 1.0),
    "azimuth": ("INS_Azi", np.pi / 180.0),
    "pitch": ("INS_Pitch", np.pi / 180.0),
    "roll": ("INS_Roll", np.pi / 180.0),
}
_POSITIONS: Final[dict[str, tuple[str, float]]] = {
    "t": ("BGP_second", 1.0),
    "lat": ("BGP_Lat", np.pi / 180.0),
    "lon": ("BGP_Long", np.pi / 180.0),
    "height": ("BGP_Alt", 1.0),
    "std_e": ("BGP_Long_std", 1.0),
    "std_n": ("BGP_Lat_std", 1.0),
    "std_u": ("BGP_Alt_std", 1.0),
}
_VELOCITIES: Final[dict[str, tuple[str, float]]] = {
    "t": ("BGV_second", 1.0),
    "v_e": ("BGV_ve", 1.0),
    "v_n": ("BGV_vn", 1.0),
    "v_u": ("BGV_vu", 1.0),
}
_ODOMETER: Final[dict[str, tuple[str, float]]] = {
    "t": ("CarChip_second_1HZ", 1.0),
    "speed": ("CarChip_Speed_1HZ", 1.0),
}


def read_navinst(folder: Path, descriptor: Descriptor) -> Published:
    """Return the tables of a NavINST drive.

    Args:
        folder: A folder at or above the drive's.
        descriptor: Not asked here; the same for every format.

    Returns:
        IMU, odometer, fixes and, where INSPVA is there, reference; raw ranges where
        Raw_Data_combined is there.

    Raises:
        LogNotFoundError: A file is missing.
        LogError: A file is truncated, or a variable is missing or of another length.
    """
    del descriptor
    paths = {name: find_one(folder, pattern) for name, pattern in PATTERNS.items()}
    tables = {
        "imu": _imu(_required(folder, paths, "imu")),
        "odometer": _columns(_required(folder, paths, "odometer"), _ODOMETER),
        "fixes": _columns(_required(folder, paths, "positions"), _POSITIONS),
    }
    files = {"imu": paths["imu"], "odometer": paths["odometer"], "fixes": paths["positions"]}
    if paths["velocities"] is not None:
        velocities = _columns(paths["velocities"], _VELOCITIES)
        tables["fixes"] = tables["fixes"].merge(velocities, on="t", how="left")
    if paths["reference"] is not None:
        tables["reference"] = _columns(paths["reference"], _REFERENCE)
        files["reference"] = paths["reference"]
    ranges = read_navinst_ranges(folder)
    if ranges is not None:
        tables["ranges"], files["ranges"] = ranges.table, ranges.path
    return Published(
        tables=tables,
        files={name: path.name for name, path in files.items() if path is not None},
        source=f"navinst: {folder}",
        axes="RFU",
        geoid_height=KINGSTON_GEOID_HEIGHT,
        time_scale="GPS seconds of week",
        interval_means=("imu",),
        range_corrections=() if ranges is None else ranges.corrections,
        klobuchar=() if ranges is None else ranges.klobuchar,
        gps_time_origin=None if ranges is None else ranges.gps_time_origin,
    )


def _required(folder: Path, paths: Mapping[str, Path | None], name: str) -> Path:
    path = paths[name]
    if path is None:
        raise LogNotFoundError(
            f"{folder}: no {PATTERNS[name]} in or below it, which a NavINST drive needs; found "
            f"{listing(folder)}"
        )
    return path


def _columns(path: Path, names: Mapping[str, tuple[str, float]]) -> pd.DataFrame:
    variables = load_variables(path)
    found = {
        column: vector(path, variables, variable) * factor
        for column, (variable, factor) in names.items()
    }
    return table_of(path, found)


def _imu(path: Path) -> pd.DataFrame:
    variables = load_variables(path)
    columns = {"t": vector(path, variables, "IMU_second")}
    for variable, prefix in (("w", "gyro"), ("f", "accel")):
        triad = variables.get(variable)
        if not isinstance(triad, np.ndarray) or triad.dtype.names is None:
            raise LogError(f"{path.name}: no structure {variable} with fields x, y, z")
        for axis in ("x", "y", "z"):
            if axis not in triad.dtype.names:
                raise LogError(f"{path.name}: structure {variable} has no field {axis}")
            columns[f"{prefix}_{axis}"] = vector(path, {axis: triad[axis].flat[0]}, axis)
    return table_of(path, columns)
