"""What two streams of a log may be compared by: turns, speeds, gains of speed.

Each comparison is observations and the regressors that explain them for any delay. Direction of
motion is that of the antenna: ahead of the rear axle it turns early at low speed, and side slip
turns it late at high speed, some 0.05 s each; the forces know neither.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.delay_fit import Design
from navlearn.logs.quality.signals import (
    Array,
    column,
    curve_through,
    integral,
    median_interval,
    track_of,
)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What is laid side by side: observations, and the regressors for any delay."""

    t: Array
    observed: Array
    weight: Array
    design: Design
    overlap: int = 1


def turn_comparison(
    log: DriveLog, table: Literal["fixes", "reference"], *, gyro: str = "gyro_z"
) -> Comparison | str:
    """Lay the turns of fixes or reference beside the turned angle of a gyro.

    Args:
        log: The log, in order.
        table: Which directions are observed.
        gyro: Column of ``imu`` that is taken as the yaw rate.

    Returns:
        Observed: change of heading over about a second. Regressors: turned angle, time.
    """
    rows = log.fixes if table == "fixes" else log.reference
    if rows is None or len(rows) < 3:
        return f"the log has no {table}"
    t = column(log.imu, "t")
    if len(t) < 3 or not np.any(np.isfinite(column(log.imu, gyro))):
        return f"the log has no {gyro}"
    track = track_of(rows)
    t_h, heading, speed = track.t_v, track.heading, track.speed
    azimuth = column(rows, "azimuth")
    if np.count_nonzero(np.isfinite(azimuth)) > 0.5 * len(rows):
        known = np.isfinite(azimuth)
        t_h, heading = column(rows, "t")[known], -np.unwrap(azimuth[known])
        speed = np.interp(t_h, track.t_v, track.speed) if len(track.t_v) else np.zeros(len(t_h))
    if len(t_h) < 3:
        return f"the {table} hold no direction of motion"
    lag = max(1, round(1.0 / median_interval(t_h)))
    slow = 3.0 if track.measured else 5.0
    first, last = slice(None, -lag), slice(lag, None)
    pace = np.minimum(speed[first], speed[last])
    near = (t_h[last] - t_h[first]) < 2.5 * lag * median_interval(t_h)
    used = near & (pace > slow)
    a, b = t_h[first][used], t_h[last][used]
    angle = integral(log, gyro)

    def design(delay: Array) -> Array:
        turned = _at(b - delay, t, angle) - _at(a - delay, t, angle)
        return np.stack((turned, b - a), axis=-1)

    return Comparison(
        t=0.5 * (a + b),
        observed=heading[last][used] - heading[first][used],
        weight=np.minimum(pace[used], 15.0) / 15.0,
        design=design,
        overlap=lag,
    )


def speed_comparison(log: DriveLog, table: Literal["fixes", "reference"]) -> Comparison | str:
    """Lay the odometer's speed beside that of fixes or reference.

    Returns:
        Observed: odometer speed in motion. Regressor: the other speed.
    """
    rows = log.fixes if table == "fixes" else log.reference
    t, speed = _speeds(log, "odometer")
    if len(t) < 3:
        return "the log has no odometer"
    if rows is None or len(rows) < 3:
        return f"the log has no {table}"
    track = track_of(rows)
    other = curve_through(track.t_v, track.speed, longest=2.5 * median_interval(track.t_v))
    moving = np.abs(speed) > 1.0
    t, speed = t[moving], speed[moving]

    def design(delay: Array) -> Array:
        return other(t - delay)[:, None]

    return Comparison(t=t, observed=speed, weight=np.ones(len(t)), design=design)


def gain_comparison(
    log: DriveLog, table: Literal["odometer", "fixes"], *, along: str = "accel_y"
) -> Comparison | str:
    """Lay the growth of a speed beside the integral of forward specific force.

    Args:
        log: The log, in order.
        table: Whose speed is observed.
        along: Column of ``imu`` that is taken as the forward specific force.

    Returns:
        Observed: gain of speed over about a second. Regressors: integrated force, time.
    """
    t = column(log.imu, "t")
    if len(t) < 3 or not np.any(np.isfinite(column(log.imu, along))):
        return f"the log has no {along}"
    t_o, speed = _speeds(log, table)
    if len(t_o) < 3:
        return f"the log has no speeds of the {table}"
    lag = max(1, round(1.0 / median_interval(t_o)))
    a, b = t_o[:-lag], t_o[lag:]
    near = (b - a) < 2.5 * lag * median_interval(t_o)
    used = near & (np.maximum(np.abs(speed[:-lag]), np.abs(speed[lag:])) > 1.0)
    a, b = a[used], b[used]
    velocity = integral(log, along)

    def design(delay: Array) -> Array:
        gained = _at(b - delay, t, velocity) - _at(a - delay, t, velocity)
        return np.stack((gained, b - a), axis=-1)

    return Comparison(
        t=0.5 * (a + b),
        observed=(speed[lag:] - speed[:-lag])[used],
        weight=np.ones(len(a)),
        design=design,
        overlap=lag,
    )


def _speeds(log: DriveLog, table: Literal["odometer", "fixes"]) -> tuple[Array, Array]:
    if table == "fixes":
        track = track_of(log.fixes)
        return track.t_v, track.speed
    speed = column(log.odometer, "speed")
    known = np.isfinite(speed)
    return column(log.odometer, "t")[known], speed[known]


def _at(when: Array, t: Array, x: Array) -> Array:
    return np.interp(when, t, x, left=np.nan, right=np.nan)
