"""The canonical columns of a drive log's tables, with unit and meaning.

Every table has ``t``: seconds from the start of the log, float64, strictly increasing.
A column that a log does not have is absent; a value that is not available is NaN.
"""

from typing import Final

IMU: Final[dict[str, str]] = {
    "gyro_x": "angular rate about x (right), rad/s",
    "gyro_y": "angular rate about y (forward), rad/s",
    "gyro_z": "angular rate about z (up), rad/s, left turn positive: the yaw rate",
    "accel_x": "specific force along x (right), m/s²",
    "accel_y": "specific force along y (forward), m/s²",
    "accel_z": "specific force along z (up), m/s², +g when level and parked",
    "temperature": "sensor temperature, °C",
}
"""``imu``: only ``gyro_z`` is required."""

ODOMETER: Final[dict[str, str]] = {"speed": "speed along the forward axis, m/s"}
"""``odometer``."""

FIXES: Final[dict[str, str]] = {
    "lat": "geodetic latitude of the antenna, rad",
    "lon": "longitude of the antenna, rad",
    "height": "height of the antenna above the ellipsoid, m",
    "v_e": "velocity to the east, m/s",
    "v_n": "velocity to the north, m/s",
    "v_u": "velocity up, m/s",
    "std_e": "standard deviation of position to the east, m",
    "std_n": "standard deviation of position to the north, m",
    "std_u": "standard deviation of height, m",
    "std_v": "standard deviation of each velocity component, m/s",
    "satellites": "satellites used in the solution",
}
"""``fixes``: ``lat`` and ``lon`` are required."""

REFERENCE: Final[dict[str, str]] = {
    "lat": "geodetic latitude, rad",
    "lon": "longitude, rad",
    "height": "height above the ellipsoid, m",
    "v_e": "velocity to the east, m/s",
    "v_n": "velocity to the north, m/s",
    "v_u": "velocity up, m/s",
    "azimuth": "azimuth of the forward axis, rad, clockwise from north",
    "pitch": "pitch, rad, nose up positive",
    "roll": "roll, rad, right side down positive",
}
"""``reference``: ``lat`` and ``lon`` are required."""

TABLES: Final[dict[str, dict[str, str]]] = {
    "imu": IMU,
    "odometer": ODOMETER,
    "fixes": FIXES,
    "reference": REFERENCE,
}

REQUIRED: Final[dict[str, tuple[str, ...]]] = {
    "imu": ("gyro_z",),
    "odometer": ("speed",),
    "fixes": ("lat", "lon"),
    "reference": ("lat", "lon"),
}
