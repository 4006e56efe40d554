"""Drives as the NavINST laboratory publishes them: a tree of MATLAB files.

``f_w_IMSseconds_dt.mat`` holds the IMU (already x right, y forward, z up), a CarChip file the
OBD-II speed, ``BESTGPSPOS`` and ``BESTGPSVEL`` the NovAtel fixes, ``INSPVA`` the reference.
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
from navlearn.logs.interval_means import FloatArray

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
        IMU, odometer, fixes and, where INSPVA is there, reference.

    Raises:
        LogNotFoundError: A file is missing.
        LogError: A file is truncated, or a variable is missing or of another length.
    """
    del descriptor
    paths = {name: _find(folder, pattern) for name, pattern in PATTERNS.items()}
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
    return Published(
        tables=tables,
        files={name: path.name for name, path in files.items() if path is not None},
        source=f"navinst: {folder}",
        axes="RFU",
        geoid_height=KINGSTON_GEOID_HEIGHT,
        time_scale="GPS seconds of week",
        interval_means=("imu",),
    )


def _find(folder: Path, name: str) -> Path | None:
    found = sorted(folder.rglob(name))
    if len(found) > 1:
        raise LogError(
            f"{folder}: {len(found)} drives below it ({found[0].parent}, {found[1].parent}); name "
            "the folder of one"
        )
    return found[0] if found else None


def _required(folder: Path, paths: Mapping[str, Path | None], name: str) -> Path:
    path = paths[name]
    if path is None:
        raise LogNotFoundError(
            f"{folder}: no {PATTERNS[name]} in or below it, which a NavINST drive needs; found "
            f"{listing(folder)}"
        )
    return path


def _load(path: Path) -> dict[str, object]:
    import scipy.io

    try:
        variables: dict[str, object] = scipy.io.loadmat(path, squeeze_me=False)
    except Exception as error:
        # A damaged file makes SciPy fail in many ways, private classes among them.
        raise LogError(
            f"{path.name}: not readable as a MATLAB 5 file ({path.stat().st_size} bytes; {error}); "
            "it is truncated or damaged: fetch it again"
        ) from error
    return variables


def _vector(path: Path, variables: Mapping[str, object], name: str) -> FloatArray:
    if name not in variables:
        found = ", ".join(key for key in variables if not key.startswith("__")) or "nothing"
        raise LogError(
            f"{path.name}: no variable {name}; found {found}; a file cut short loses its last "
            "variables: fetch it again"
        )
    try:
        return np.asarray(variables[name], dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise LogError(f"{path.name}: variable {name} is not numbers ({error})") from error


def _table(path: Path, columns: Mapping[str, FloatArray]) -> pd.DataFrame:
    lengths = {name: values.size for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise LogError(f"{path.name}: variables differ in length: {lengths}; fetch the file again")
    return pd.DataFrame(dict(columns))


def _columns(path: Path, names: Mapping[str, tuple[str, float]]) -> pd.DataFrame:
    variables = _load(path)
    found = {
        column: _vector(path, variables, variable) * factor
        for column, (variable, factor) in names.items()
    }
    return _table(path, found)


def _imu(path: Path) -> pd.DataFrame:
    variables = _load(path)
    columns = {"t": _vector(path, variables, "IMU_second")}
    for variable, prefix in (("w", "gyro"), ("f", "accel")):
        triad = variables.get(variable)
        if not isinstance(triad, np.ndarray) or triad.dtype.names is None:
            raise LogError(f"{path.name}: no structure {variable} with fields x, y, z")
        for axis in ("x", "y", "z"):
            if axis not in triad.dtype.names:
                raise LogError(f"{path.name}: structure {variable} has no field {axis}")
            columns[f"{prefix}_{axis}"] = _vector(path, {axis: triad[axis].flat[0]}, axis)
    return _table(path, columns)
