"""Ten-line drives that the tests bend out of shape."""

import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.drive_log import DriveLog, LogMetadata

DATA = Path(
    os.environ.get("NAVLEARN_DATA")
    or Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
)


def small_tables() -> dict[str, pd.DataFrame]:
    """Return 10 s of a gentle left turn: IMU 10 Hz, odometer 2 Hz, fixes and reference 1 Hz."""
    imu_t, odometer_t, fix_t = np.arange(101) / 10.0, np.arange(21) / 2.0, np.arange(11.0)
    lat = math.radians(44.23) + fix_t * 1.5e-6
    lon = math.radians(-76.49) + fix_t * 1e-7
    fixes = pd.DataFrame({"t": fix_t, "lat": lat, "lon": lon, "height": 80.0 + 0.0 * fix_t})
    return {
        "imu": pd.DataFrame(
            {
                "t": imu_t,
                "gyro_x": 0.001 * imu_t,
                "gyro_y": 0.002 + 0.0 * imu_t,
                "gyro_z": 0.02 + 0.001 * np.sin(imu_t),
                "accel_x": -0.2 + 0.0 * imu_t,
                "accel_y": 0.1 + 0.01 * imu_t,
                "accel_z": 9.8 + 0.0 * imu_t,
            }
        ),
        "odometer": pd.DataFrame({"t": odometer_t, "speed": 9.0 + 0.1 * odometer_t}),
        "fixes": fixes.assign(v_e=0.3, v_n=9.5, v_u=0.0, std_e=1.5, std_n=1.5, std_u=3.0),
        "reference": fixes.assign(v_e=0.3, v_n=9.5, azimuth=np.mod(0.1 - 0.02 * fix_t, 6.28)),
    }


@pytest.fixture
def tables() -> dict[str, pd.DataFrame]:
    """Tables of a small drive, to be changed at will."""
    return small_tables()


@pytest.fixture
def make_log() -> Callable[..., DriveLog]:
    """Build a small drive, some of its tables replaced."""

    def make(**changed: pd.DataFrame | LogMetadata | None) -> DriveLog:
        parts = {**small_tables(), "metadata": LogMetadata(name="small"), **changed}
        return DriveLog(**parts)

    return make


SKY = {"G02": (2.0e7, 1.2e7, 1.1e7), "G30": (-1e7, 2e7, 1.5e7), "R07": (1.4e7, -1.5e7, 1.5e7)}


def small_ranges(times: Iterable[float] = range(10)) -> pd.DataFrame:
    """Return ranges of three satellites, once a second."""
    rows = [
        (float(t), name, 2.1e7 + 1e3 * k + t, *SKY[name], 45.0 - k)
        for t in times
        for k, name in enumerate(SKY)
    ]
    columns = ["t", "satellite", "pseudorange", "sat_x", "sat_y", "sat_z", "cn0"]
    return pd.DataFrame(rows, columns=columns)


@pytest.fixture
def range_table() -> Callable[..., pd.DataFrame]:
    """Make a table of ranges, to be changed at will."""
    return small_ranges


@pytest.fixture
def broadcast() -> LogMetadata:
    """What a log knows whose ranges are corrected for clocks alone."""
    return LogMetadata(
        name="small",
        range_corrections=("satellite_clock", "earth_rotation"),
        klobuchar=(1e-8, 1.5e-8, -6e-8, -1.2e-7, 8e4, 1e5, -6.6e4, -5.2e5),
        gps_time_origin=1485 * 604800.0 + 152142.25,
    )


@pytest.fixture
def data_folder() -> Callable[[str], Path]:
    """Find a real log, or skip the test."""

    def find(name: str) -> Path:
        if not (DATA / name).is_dir():
            pytest.skip(f"{DATA / name} is not there; set NAVLEARN_DATA to the folder of real logs")
        return DATA / name

    return find
