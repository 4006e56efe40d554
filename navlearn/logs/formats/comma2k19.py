"""Drives as comma2k19 publishes them: folders of NumPy arrays, `t` beside `value`.

[Schafer2018] and the README of the data. A segment is a minute: ``processed_log`` with IMU (x
forward, y right, z down), CAN and GNSS, and ``global_pose`` (also ``global_pos``) of the camera,
Earth-fixed; consecutive segments of a route make one drive. Times are the device's since boot.
Fixes reach it with a jitter of tens of milliseconds while their UTC is exact, so they are placed
by it (:mod:`navlearn.logs.formats.epochs`).

Camera and IMU sit in one case: what levels the one levels the other, and the reference's angles
are those of the case turned by the descriptor's ``axes`` and ``mounting``.
"""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import torch

from navlearn import attitude, frames
from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.assemble import Published, without_empty_fixes
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.formats.epochs import clock_from_epochs
from navlearn.logs.formats.finding import listing
from navlearn.logs.interval_means import FloatArray

PUBLISHED_AXES: Final = "FRD"
_CLOCKS_APART: Final = 5.0
_POSES: Final = ("global_pose", "global_pos")
_RECEIVERS: Final = ("live_gnss_ublox", "live_gnss_qcom")


def read_comma2k19(folder: Path, descriptor: Descriptor) -> Published:
    """Return the tables of a comma2k19 drive.

    Args:
        folder: A segment, a route of several, or a folder above one route.
        descriptor: Its axes and mounting level the reference's angles too.

    Returns:
        IMU, odometer (mean of the wheel speeds, else the car's own speed), fixes (u-blox, else
        the phone's), and the pose of the camera as reference where it is there.

    Raises:
        LogNotFoundError: A folder or an array is missing.
        LogError: Several routes, or an array that is damaged or of another shape.
    """
    segments = _segments(folder)
    turn = descriptor.body_from_sensor(PUBLISHED_AXES)
    parts = {"imu": [_imu(s) for s in segments], "odometer": [_odometer(s) for s in segments]}
    fixes = pd.concat([_fixes(s) for s in segments], ignore_index=True)
    poses = [pose for s in segments if (pose := _reference(s, turn)) is not None]
    tables = {name: pd.concat(found, ignore_index=True) for name, found in parts.items()}
    tables["fixes"] = _on_their_epochs(fixes)
    if poses:
        tables["reference"] = pd.concat(poses, ignore_index=True)
    places = {"imu": "processed_log/IMU", "odometer": "processed_log/CAN"}
    places |= {"fixes": "processed_log/GNSS", "reference": "global_pose"}
    return Published(
        tables=tables,
        files={name: places[name] for name in tables},
        source=f"comma2k19: {segments[0].parent if len(segments) > 1 else segments[0]}",
        axes=PUBLISHED_AXES,
        time_scale="device's clock, s since boot",
        extra={"segments": [segment.name for segment in segments]},
    )


def has_segments(folder: Path) -> bool:
    """Tell whether a comma2k19 segment lies at or below a folder.

    Args:
        folder: Folder to look in.
    """
    return next(folder.rglob("processed_log/IMU"), None) is not None


def _segments(folder: Path) -> list[Path]:
    found = [path.parent for path in folder.rglob("processed_log") if path.is_dir()]
    if not found:
        raise LogNotFoundError(
            f"{folder}: no folder processed_log in or below it, which a comma2k19 drive needs; "
            f"found {listing(folder)}"
        )
    routes = sorted({path.parent for path in found})
    if len(routes) > 1:
        raise LogError(
            f"{folder}: {len(routes)} routes below it ({routes[0].name}, {routes[1].name} …); name "
            "the folder of one"
        )
    return sorted(found, key=lambda path: (len(path.name), path.name))


def _array(path: Path, columns: int) -> FloatArray:
    where = "/".join(path.parts[-3:])
    if not path.is_file():
        home = path.parent
        beside = listing(home) if home.is_dir() else "no such folder"
        raise LogNotFoundError(f"{path}: no such array; found {beside}")
    try:
        with path.open("rb") as stream:
            values = np.asarray(np.load(stream, allow_pickle=False), dtype=np.float64)
            rest = len(stream.read())
    except Exception as error:
        # A damaged header makes NumPy fail in many ways, those of Python's own parser among them.
        raise LogError(
            f"{where}: not readable as a NumPy array of numbers ({error}); fetch it again"
        ) from error
    if rest:
        raise LogError(f"{where}: {rest} bytes beyond its array of {values.shape}; fetch it again")
    rows = values.shape[0] if values.ndim else 0
    if values.size != rows * columns:
        raise LogError(f"{where}: found shape {values.shape}, expected (N, {columns})")
    return values.reshape(rows, columns)


def _pair(folder: Path, columns: int) -> tuple[FloatArray, FloatArray]:
    t, values = _array(folder / "t", 1)[:, 0], _array(folder / "value", columns)
    if t.size != len(values):
        where = "/".join(folder.parts[-3:])
        raise LogError(f"{where}: {t.size} times for {len(values)} values; fetch it again")
    return t, values


def _imu(segment: Path) -> pd.DataFrame:
    home = segment / "processed_log" / "IMU"
    t, rates = _pair(home / "gyro", 3)
    force_t, forces = _pair(home / "accelerometer", 3)
    columns = {"t": t} | {f"gyro_{axis}": rates[:, i] for i, axis in enumerate("xyz")}
    for i, axis in enumerate("xyz"):
        same = force_t.size == t.size and bool((force_t == t).all())
        columns[f"accel_{axis}"] = (
            forces[:, i] if same else np.interp(t, force_t, forces[:, i], left=np.nan, right=np.nan)
        )
    return pd.DataFrame(columns)


def _odometer(segment: Path) -> pd.DataFrame:
    home = segment / "processed_log" / "CAN"
    if (home / "wheel_speed").is_dir():
        t, wheels = _pair(home / "wheel_speed", 4)
        return pd.DataFrame({"t": t, "speed": wheels.mean(axis=1)})
    t, speed = _pair(home / "speed", 1)
    return pd.DataFrame({"t": t, "speed": speed[:, 0]})


def _fixes(segment: Path) -> pd.DataFrame:
    home = segment / "processed_log" / "GNSS"
    receiver = next((name for name in _RECEIVERS if (home / name).is_dir()), _RECEIVERS[0])
    t, values = _pair(home / receiver, 6)
    lat, lon, speed, utc_ms, height, bearing = values.T
    course = np.radians(bearing)
    return pd.DataFrame(
        {
            "t": t,
            "epoch": utc_ms / 1e3,
            "lat": np.radians(lat),
            "lon": np.radians(lon),
            "height": height,
            "v_e": speed * np.sin(course),
            "v_n": speed * np.cos(course),
        }
    )


def _on_their_epochs(fixes: pd.DataFrame) -> pd.DataFrame:
    fixes = without_empty_fixes(fixes)
    if fixes.empty:
        return fixes.drop(columns="epoch")
    epoch, arrival = (fixes[name].to_numpy(np.float64) for name in ("epoch", "t"))
    if not np.abs(np.ptp(epoch) - np.ptp(arrival)) < _CLOCKS_APART:
        raise LogError(
            f"processed_log/GNSS: fixes span {np.ptp(epoch):.6g} s of UTC and arrived within "
            f"{np.ptp(arrival):.6g} s; an array is damaged: fetch it again"
        )
    t, _ = clock_from_epochs(epoch, arrival)
    return fixes.assign(t=t).drop(columns="epoch")


def _reference(segment: Path, turn: FloatArray) -> pd.DataFrame | None:
    home = next((segment / name for name in _POSES if (segment / name).is_dir()), None)
    if home is None:
        return None
    t = _array(home / "frame_times", 1)[:, 0]
    place, v_e, q = (
        torch.from_numpy(_array(home / f"frame_{name}", columns))
        for name, columns in (("positions", 3), ("velocities", 3), ("orientations", 4))
    )
    lat, lon, height = frames.geodetic_from_ecef(place)
    to_local = frames.enu_from_ecef_matrix(lat, lon)
    v_l = (to_local @ v_e.unsqueeze(-1)).squeeze(-1)
    # The quaternion turns vectors of the case into Earth-fixed ones.
    c_lb = to_local @ attitude.matrix_from_quaternion(q) @ torch.from_numpy(turn.T.copy())
    azimuth, pitch, roll = attitude.angles_from_matrix(c_lb)
    azimuth = torch.remainder(azimuth, 2.0 * torch.pi)
    columns = {"lat": lat, "lon": lon, "height": height, "v_e": v_l[:, 0], "v_n": v_l[:, 1]}
    columns |= {"v_u": v_l[:, 2], "azimuth": azimuth, "pitch": pitch, "roll": roll}
    return pd.DataFrame({"t": t, **{name: values.numpy() for name, values in columns.items()}})
