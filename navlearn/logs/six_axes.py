"""Are the six axes of a full IMU there, in SI units, and upright?

A strapdown integrates whatever it is given; each of these slips would give a drive to the moon.
"""

from typing import Final

import numpy as np

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_means import known_samples
from navlearn.logs.validate import FASTEST_TURN, label

GYROS: Final = ("gyro_x", "gyro_y", "gyro_z")
ACCELEROMETERS: Final = ("accel_x", "accel_y", "accel_z")

STANDARD_GRAVITY: Final = 9.80665
"""m/s²."""

STEEPEST_MOUNT: Final = 45.0
"""No axis called "up" leans further, °."""


def check_six_axes(log: DriveLog) -> None:
    """Refuse a log whose IMU table no strapdown can use.

    Args:
        log: Drive.

    Raises:
        LogError: An axis is missing, the gyros are not in rad/s, gravity is missing from the
            accelerometers, in units of g, or not along z.
    """
    where = label(log, "imu")
    _require_axes(log, where)
    for axis in GYROS:
        _, values = known_samples(log, axis)
        fast = float(np.quantile(np.abs(values), 0.99))
        if fast > FASTEST_TURN:
            raise LogError(
                f"{where}: {axis} exceeds {fast:.3g} rad/s in 1 % of its rows, more than a car "
                f"turns; if it is in degrees per second, name the column {axis}_deg_per_s or give "
                "unit: deg/s in a descriptor"
            )
    _check_gravity(where, [known_samples(log, axis)[1] for axis in ACCELEROMETERS])


def _require_axes(log: DriveLog, where: str) -> None:
    needed = (*GYROS, *ACCELEROMETERS)
    found = [axis for axis in needed if known_samples(log, axis)[0].size]
    missing = [axis for axis in needed if axis not in found]
    if missing:
        raise LogError(
            f"{where}: a full IMU needs {', '.join(needed)}; found {', '.join(found) or 'none'}, "
            f"no values in {', '.join(missing)}; with a yaw gyro and an odometer alone use the "
            "RISS (riss_timeline, mechanization.sensors: riss)"
        )


def _check_gravity(where: str, force: list[np.ndarray]) -> None:
    middle = np.array([np.median(axis) for axis in force])
    size = float(np.linalg.norm(middle))
    told = f"median specific force is ({middle[0]:.3g}, {middle[1]:.3g}, {middle[2]:.3g})"
    if abs(size - 1.0) < 0.1:
        raise LogError(
            f"{where}: {told} m/s², expected +9.8 along z; if it is in units of g, name the "
            "columns accel_x_g … or give unit: g in a descriptor"
        )
    if size < 0.5 * STANDARD_GRAVITY:
        raise LogError(
            f"{where}: {told} m/s², expected +9.8 along z: gravity is missing; it looks like "
            "'linear acceleration', from which a phone has taken gravity off; log the raw "
            "accelerometer, or add the phone's gravity channel back"
        )
    if abs(size - STANDARD_GRAVITY) > 0.1 * STANDARD_GRAVITY:
        raise LogError(
            f"{where}: {told} m/s², expected a norm of 9.8; check the unit of the accelerometers"
        )
    lean = float(np.degrees(np.arccos(np.clip(middle[2] / size, -1.0, 1.0))))
    if lean > STEEPEST_MOUNT:
        axis = int(np.argmax(np.abs(middle)))
        sign = "-" if middle[axis] < 0.0 else ""
        raise LogError(
            f"{where}: {told} m/s², expected +9.8 along z, which leans {lean:.0f}° here: gravity "
            f"is felt along {sign}{'xyz'[axis]}; give the sensor's axes in a descriptor, such as "
            f"axes: {{right: ..., forward: ..., up: {sign}{'xyz'[axis]}}}"
        )
