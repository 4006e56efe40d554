"""Units and axes that one table alone gives away: degrees, gravity, impossible sizes."""

import numpy as np

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.findings import Part
from navlearn.logs.quality.signals import Array, column, looks_like_degrees

_GRAVITY = 9.81


def check_units(log: DriveLog) -> Part:
    """Check units and axes of each table by itself; the log is in order."""
    part = Part()
    for name, table in log.tables().items():
        if name in ("fixes", "reference") and len(table):
            _check_position(part, log, name)
    _check_sizes(part, log)
    _check_gravity(part, log)
    return part


def in_radians(log: DriveLog) -> DriveLog:
    """Return the log with positions that are clearly in degrees turned into radians."""
    turned = {
        name: table.assign(lat=np.radians(table["lat"]), lon=np.radians(table["lon"]))
        for name, table in log.tables().items()
        if name in ("fixes", "reference") and looks_like_degrees(table)
    }
    return log.with_tables(turned)


def _check_position(part: Part, log: DriveLog, name: str) -> None:
    table = log.tables()[name]
    lat, lon = column(table, "lat"), column(table, "lon")
    if looks_like_degrees(table):
        part.add(
            "error",
            "degrees for radians",
            f"{name} lat, lon",
            f"latitude to {_largest(lat):.6g}, longitude to {_largest(lon):.6g}",
            "latitude within ±1.571 rad, longitude within ±6.283 rad",
            "name the unit deg in the descriptor or turn the columns into radians",
        )
    zero = np.count_nonzero((lat == 0.0) & (lon == 0.0))
    if zero and zero < np.count_nonzero(np.isfinite(lat)):
        row = int(np.flatnonzero((lat == 0.0) & (lon == 0.0))[0])
        part.add(
            "error",
            "placeholder position",
            f"{name} row {row}",
            f"{zero} rows at latitude 0, longitude 0",
            "an empty field where there is no position",
            "make those rows NaN in the reader",
        )


def _largest(x: Array) -> float:
    return float(np.max(np.abs(x[np.isfinite(x)]), initial=0.0))


def _check_sizes(part: Part, log: DriveLog) -> None:
    limits = (
        ("imu", "gyro_z", 2.0, "rad/s", "is it in deg/s? name its unit in the descriptor"),
        ("odometer", "speed", 70.0, "m/s", "is it in km/h? name its unit in the descriptor"),
    )
    for table, channel, limit, unit, remedy in limits:
        x = np.abs(column(log.tables()[table], channel))
        x = x[np.isfinite(x)]
        if len(x) and float(np.quantile(x, 0.98)) > limit:
            part.add(
                "error",
                "impossible size",
                f"{table} {channel}",
                f"2 % of it beyond {np.quantile(x, 0.98):.3g} {unit}",
                f"a road vehicle below {limit:g} {unit}",
                remedy,
            )


def _check_gravity(part: Part, log: DriveLog) -> None:
    names = ("accel_x", "accel_y", "accel_z")
    if len(log.imu) == 0 or not all(name in log.imu for name in names):
        part.not_observable["tilt_deg"] = "the log lacks an accelerometer axis"
        return
    samples = [column(log.imu, name) for name in names]
    samples = [x[np.isfinite(x)] for x in samples]
    if not all(len(x) for x in samples):
        part.not_observable["tilt_deg"] = "an accelerometer axis is empty"
        return
    mean = np.array([float(np.mean(x)) for x in samples])
    size = float(np.linalg.norm(mean))
    part.figures["mean_specific_force_m_s2"] = size
    if size < 3.0:
        what = "in units of g" if 0.8 < size < 1.2 else "without gravity"
        part.add(
            "error",
            "gravity missing",
            "imu accel_x, accel_y, accel_z",
            f"mean specific force {size:.3g} m/s²: probably {what}",
            f"about {_GRAVITY} m/s²",
            "give the raw specific force in m/s²; multiply by 9.80665 if it is in g",
        )
        return
    if abs(size - _GRAVITY) > 0.5:
        part.add(
            "warning",
            "gravity size",
            "imu accel_x, accel_y, accel_z",
            f"mean specific force {size:.3f} m/s²",
            f"about {_GRAVITY} m/s²",
            "check the accelerometer's scale",
        )
    _check_axis(part, mean, size)


def _check_axis(part: Part, mean: Array, size: float) -> None:
    axis = int(np.argmax(np.abs(mean)))
    if axis != 2 or mean[2] < 0.0:
        part.add(
            "error",
            "gravity axis" if axis != 2 else "gravity sign",
            "imu " + ("accel_x", "accel_y", "accel_z")[axis],
            f"mean specific force ({mean[0]:.2f}, {mean[1]:.2f}, {mean[2]:.2f}) m/s²",
            "(0, 0, +9.8): x right, y forward, z up, gravity's reaction upwards",
            "turn the axes in the descriptor" + (" (z is down?)" if axis == 2 else ""),
        )
        return
    tilt = float(np.degrees(np.arccos(np.clip(mean[2] / size, -1.0, 1.0))))
    part.figures["tilt_deg"] = tilt
    part.figures["mean_roll_deg"] = float(np.degrees(np.arctan2(-mean[0], mean[2])))
    part.figures["mean_pitch_deg"] = float(np.degrees(np.arctan2(mean[1], mean[2])))
    if tilt > 2.0:
        part.add(
            "warning" if tilt > 10.0 else "info",
            "tilted sensor",
            "imu",
            f"the mean specific force leans {tilt:.1f}° from z",
            "a levelled sensor",
            "level the sensor when reading, or let the mechanization estimate tilt",
        )
