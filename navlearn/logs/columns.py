"""The canonical columns of a drive log's tables, with unit and meaning.

Every table has ``t``: seconds from the start of the log, float64, strictly increasing (but in
``ranges``, where the satellites of one reception share it).
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

RANGES: Final[dict[str, str]] = {
    "satellite": "text: constellation by its RINEX letter (G GPS, R GLONASS, E Galileo, C BeiDou, "
    "J QZSS, S SBAS, I NavIC) and number of two digits or more, such as G07",
    "pseudorange": "code pseudorange on the receiver's clock, m",
    "range_rate": "rate of the pseudorange by Doppler, m/s, positive when moving apart",
    "cn0": "carrier-to-noise density, dB-Hz",
    "std_range": "standard deviation of the pseudorange as the receiver tells it, m",
    "std_rate": "standard deviation of the range rate as the receiver tells it, m/s",
    "sat_x": "satellite when it sent, Earth-fixed x, m",
    "sat_y": "the same, y, m",
    "sat_z": "the same, z, m",
    "sat_vx": "velocity of the satellite against the Earth, x, m/s",
    "sat_vy": "the same, y, m/s",
    "sat_vz": "the same, z, m/s",
    "sat_clock": "satellite clock ahead of its system's time, times the speed of light, m: added "
    "to the pseudorange",
    "sat_clock_rate": "its rate, m/s: added to the range rate",
    "ionosphere": "delay by the ionosphere, m: taken off the pseudorange",
    "troposphere": "delay by the troposphere, m: taken off the pseudorange",
}
"""``ranges``, optional: one row per reception and satellite, ordered by time; the rows of one
reception share their time. Which corrections are already in the values is told by
``LogMetadata.range_corrections``. All but ``range_rate`` to ``std_rate``, velocities, clocks and
delays are required."""

RANGE_CORRECTIONS: Final = ("satellite_clock", "ionosphere", "troposphere", "earth_rotation")
"""What may already have been done to the ranges of a log. ``earth_rotation``: the satellite's
position is in the axes of the moment of reception, not of sending."""

TABLES: Final[dict[str, dict[str, str]]] = {
    "imu": IMU,
    "odometer": ODOMETER,
    "fixes": FIXES,
    "reference": REFERENCE,
    "ranges": RANGES,
}

REQUIRED: Final[dict[str, tuple[str, ...]]] = {
    "imu": ("gyro_z",),
    "odometer": ("speed",),
    "fixes": ("lat", "lon"),
    "reference": ("lat", "lon"),
    "ranges": ("satellite", "pseudorange", "sat_x", "sat_y", "sat_z"),
}
