"""What a log itself tells about its sensors: scale, bias, latency.

Only sensors and fixes are used, never the reference; with ``until`` nothing at or after that
time is looked at, so that a calibration made before an outage may be used in it.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from navlearn import wgs84
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.comparisons import gain_comparison, speed_comparison
from navlearn.logs.quality.latency import (
    Estimate,
    Latency,
    compare,
    fitted_latency,
    ordered,
)
from navlearn.logs.quality.signals import Array, column, standstill

_SIDE_SLIP = 0.04
"""What lever arm and side slip may do to a latency told by turns, s."""

_BLOCK = 5.0
"""Length of the means from which the bias and its spread are taken, s."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a log told about its sensors; None where it could not.

    Attributes:
        odometer_scale: Reported speed per true speed: divide the odometer by it.
        gyro_bias: z gyro reading beyond the turn of the car and the Earth, rad/s: subtract it.
        gnss_latency: How late fixes are stamped against the IMU, s.
        odometer_latency: How late odometer samples are stamped against the IMU, s, at the end
            of what was looked at.
    """

    odometer_scale: Estimate | None
    gyro_bias: Estimate | None
    gnss_latency: Estimate | None
    odometer_latency: Estimate | None


def odometer_scale(log: DriveLog, *, until: float | None = None) -> Estimate | None:
    """Return reported speed per true speed, by the speed of the fixes, or None.

    Args:
        log: The log.
        until: Nothing at or after this time is used, s.
    """
    return speed_ratio(ordered(log, until=until), "fixes")


def speed_ratio(log: DriveLog, table: Literal["fixes", "reference"]) -> Estimate | None:
    """Return the odometer's speed per speed of a track, or None.

    With its latency where that can be told; otherwise, as at constant speed, without.

    Args:
        log: The log, in order.
        table: What is taken as true.
    """
    found = compare(log, "odometer", table)
    if not isinstance(found, str):
        return Estimate(found.scale, found.scale_std)
    laid = speed_comparison(log, table)
    if isinstance(laid, str):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = laid.observed / laid.design(np.zeros(len(laid.t)))[:, 0]
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) < 20:
        return None
    middle = float(np.median(ratio))
    spread = 1.4826 * float(np.median(np.abs(ratio - middle)))
    # 1.25: the median's spread against the mean's; two values in a row share one fix.
    return Estimate(middle, 1.25 * spread * float(np.sqrt(2.0 / len(ratio))) + 1e-12)


def gyro_bias_at_rest(log: DriveLog, *, until: float | None = None) -> Estimate | None:
    """Return the z gyro's bias from standstills, less the vertical Earth rate, rad/s, or None.

    Args:
        log: The log; where it has no fix the Earth rate is left in.
        until: Nothing at or after this time is used, s.
    """
    part = ordered(log, until=until)
    reading = reading_at_rest(part)
    if reading is None:
        return None
    return Estimate(reading.value - vertical_earth_rate(part), reading.std)


def gyro_bias_from_turns(log: DriveLog, *, until: float | None = None) -> Estimate | None:
    """Return the z gyro's bias against the fixes' direction of motion, rad/s, or None.

    Args:
        log: The log.
        until: Nothing at or after this time is used, s.
    """
    part = ordered(log, until=until)
    found = compare(part, "fixes", "imu")
    return None if isinstance(found, str) else _bias_from(found, part)


def gnss_latency(log: DriveLog, *, until: float | None = None) -> Estimate | None:
    """Return how late fixes are stamped against the IMU, by turns and by forces, s, or None.

    Args:
        log: The log.
        until: Nothing at or after this time is used, s.
    """
    part = ordered(log, until=until)
    return combined(ways_to_gnss_latency(part))


def odometer_latency(log: DriveLog, *, until: float | None = None) -> Estimate | None:
    """Return how late odometer samples are stamped against the IMU, s, or None.

    By forces, and by way of the fixes. Where the latency drifts along the log, it is that at
    the end of what was looked at.

    Args:
        log: The log.
        until: Nothing at or after this time is used, s.
    """
    part = ordered(log, until=until)
    ways = ways_to_odometer_latency(part, combined(ways_to_gnss_latency(part)), latest=True)
    return combined(ways)


def estimate_calibration(log: DriveLog, *, until: float | None = None) -> Calibration:
    """Return everything that the log tells about its sensors up to a time.

    Args:
        log: The log.
        until: Nothing at or after this time is used, s; None for the whole log.
    """
    part = ordered(log, until=until)
    return Calibration(
        odometer_scale=odometer_scale(part),
        gyro_bias=gyro_bias_at_rest(part) or gyro_bias_from_turns(part),
        gnss_latency=gnss_latency(part),
        odometer_latency=odometer_latency(part),
    )


def ways_to_gnss_latency(log: DriveLog) -> dict[str, Estimate]:
    """Return the latency of the fixes against the IMU by turns and by forces, where told."""
    laid = gain_comparison(log, "fixes")
    found = {
        "by_turns": compare(log, "fixes", "imu"),
        "by_force": laid if isinstance(laid, str) else fitted_latency(laid),
    }
    floor = {"by_turns": _SIDE_SLIP, "by_force": 0.0}
    return {
        way: Estimate(latency.delay, float(np.hypot(latency.std, floor[way])))
        for way, latency in found.items()
        if not isinstance(latency, str)
    }


def ways_to_odometer_latency(
    log: DriveLog, gnss: Estimate | None, *, latest: bool = False
) -> dict[str, Estimate]:
    """Return the latency of the odometer against the IMU by way of the fixes and by forces.

    Args:
        log: The log, in order.
        gnss: Latency of the fixes against the IMU.
        latest: Whether a drifting latency is taken at its end instead of its middle.
    """
    ways: dict[str, Estimate] = {}
    gains = compare(log, "odometer", "imu")
    if not isinstance(gains, str):
        ways["by_force"] = Estimate(gains.delay, gains.std)
    speeds = compare(log, "odometer", "fixes", with_drift=True)
    if gnss is None or isinstance(speeds, str):
        return ways
    by_fixes = Estimate(speeds.delay, speeds.std)
    drifts = speeds.drifts
    if latest and drifts:
        by_fixes = speeds.last
        ways.clear()
    ways["by_fixes"] = Estimate(
        by_fixes.value + gnss.value, float(np.hypot(by_fixes.std, gnss.std))
    )
    return ways


def combined(ways: dict[str, Estimate]) -> Estimate | None:
    """Return the mean of independent estimates, each weighted by its inverse variance."""
    if not ways:
        return None
    weights = np.array([1.0 / way.std**2 for way in ways.values()])
    values = np.array([way.value for way in ways.values()])
    return Estimate(float(np.average(values, weights=weights)), float(np.sum(weights) ** -0.5))


def reading_at_rest(log: DriveLog) -> Estimate | None:
    """Return the mean z gyro reading at standstill, Earth rate included, rad/s, or None.

    Args:
        log: The log, in order.
    """
    still = standstill(log)
    t, rate = column(log.imu, "t"), column(log.imu, "gyro_z")
    still &= np.isfinite(rate)
    blocks = block_means(t[still], rate[still], _BLOCK)
    if len(blocks) < 3:
        return None
    spread = float(np.std(blocks, ddof=1))
    return Estimate(float(np.mean(blocks)), max(spread, 1e-12) / float(np.sqrt(len(blocks))))


def block_means(t: Array, x: Array, length: float) -> Array:
    """Return the means of the well-filled blocks of a given length of time."""
    if len(t) == 0:
        return np.zeros(0)
    block = np.floor((t - t[0]) / length).astype(np.int64)
    _, place, count = np.unique(block, return_inverse=True, return_counts=True)
    total = np.bincount(place, weights=x)
    return np.asarray((total / count)[count >= 0.5 * np.max(count)], dtype=np.float64)


def vertical_earth_rate(log: DriveLog) -> float:
    """Return the Earth's rate about the vertical at the log's place, rad/s, zero if unknown."""
    lat = column(log.fixes, "lat")
    lat = lat[np.isfinite(lat)]
    if len(lat) == 0:
        return 0.0
    return wgs84.EARTH_RATE * float(np.sin(np.median(lat)))


def _bias_from(turns: Latency, log: DriveLog) -> Estimate:
    # heading' = scale (ω − b) − ω_e sin φ: the offset holds both.
    reading = -turns.offset / turns.scale
    std = turns.offset_std / abs(turns.scale)
    return Estimate(reading - vertical_earth_rate(log) / turns.scale, std)
