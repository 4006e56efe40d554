"""When does the car stand still? From the odometer, confirmed by the IMU.

An odometer reads zero at a crawl and after a wheel has begun to turn, so a stop is believed
late (after ``settle`` seconds) and given up early (one odometer sample before the first that
moves). Gyro and accelerometer, where there are any, must be quiet too. GNSS is never asked.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from navlearn.logs.interval_means import FloatArray, typical_period

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class StationaryOptions:
    """What counts as standing still.

    Attributes:
        max_speed: An odometer sample up to this speed says "still", m/s.
        settle: A stop is believed this long after its first still sample, s.
        window: Length of the trailing window in which the IMU must be quiet, s.
        max_gyro_spread: Largest standard deviation of the yaw rate in the window, rad/s.
        max_accel_spread: Largest standard deviation of each horizontal specific force in the
            window, m/s².
    """

    max_speed: float = 0.05
    settle: float = 1.0
    window: float = 1.0
    max_gyro_spread: float = 0.01
    max_accel_spread: float = 0.5


def stationary_intervals(
    edges: FloatArray,
    odometer_t: FloatArray,
    speed: FloatArray,
    *,
    imu_t: FloatArray | None = None,
    yaw_rate: FloatArray | None = None,
    accelerations: tuple[FloatArray, ...] = (),
    options: StationaryOptions | None = None,
) -> BoolArray:
    """Return for each interval whether the car stands still through it.

    Looks ahead two odometer samples at most, and never at GNSS.

    Args:
        edges: Ends of the intervals, s, increasing, shape (T+1,).
        odometer_t: Times of the odometer samples, s, increasing, shape (K,).
        speed: Odometer speed, m/s, shape (K,).
        imu_t: Times of the IMU samples, s, increasing, shape (N,), or None without IMU.
        yaw_rate: Yaw rate, rad/s, shape (N,), or None.
        accelerations: Specific forces, m/s², shape (N,) each.
        options: Limits; the defaults suit OBD-II odometers and MEMS sensors.

    Returns:
        True where the car stands still, shape (T,).
    """
    limits = options or StationaryOptions()
    still = _odometer_still(edges, odometer_t, speed, limits)
    if imu_t is None:
        return still
    if yaw_rate is not None:
        still &= _quiet(edges, imu_t, yaw_rate, limits.window, limits.max_gyro_spread)
    for channel in accelerations:
        still &= _quiet(edges, imu_t, channel, limits.window, limits.max_accel_spread)
    return still


def _odometer_still(
    edges: FloatArray, t: FloatArray, speed: FloatArray, limits: StationaryOptions
) -> BoolArray:
    moving = np.abs(speed) > limits.max_speed
    moved = np.concatenate(([0], np.cumsum(moving)))
    margin = typical_period(t)
    back = max(margin, limits.settle)
    first = np.maximum(np.searchsorted(t, edges[:-1] - back, side="right") - 1, 0)
    last = np.searchsorted(t, edges[1:] + margin, side="left")
    known = last < t.size
    last = np.minimum(last, t.size - 1)
    still: BoolArray = (moved[last + 1] == moved[first]) & known & (edges[:-1] - back >= t[0])
    return still


def _quiet(
    edges: FloatArray, t: FloatArray, values: FloatArray, window: float, limit: float
) -> BoolArray:
    # Sums of the centred signal: the variance is a small difference of large numbers otherwise.
    centred = values - values.mean()
    ones = np.concatenate(([0.0], np.cumsum(centred)))
    squares = np.concatenate(([0.0], np.cumsum(centred**2)))
    last = np.searchsorted(t, edges[1:] + 1e-9, side="right")
    first = np.searchsorted(t, np.minimum(edges[1:] - window, edges[:-1]), side="left")
    count = np.maximum(last - first, 1)
    mean = (ones[last] - ones[first]) / count
    variance = (squares[last] - squares[first]) / count - mean**2
    quiet: BoolArray = variance <= limit**2
    return quiet
