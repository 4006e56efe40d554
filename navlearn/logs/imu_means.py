"""IMU columns of a drive as means over the intervals of a grid, gaps refused."""

import numpy as np

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.interval_means import FloatArray, Sampling, interval_means, longest_gap


def sampling_of(log: DriveLog, table: str) -> Sampling:
    """Return whether a table's samples are means over intervals or hold at an instant.

    Args:
        log: Drive.
        table: Name of one of its tables.
    """
    return "interval" if table in log.metadata.interval_means else "instant"


def known_samples(log: DriveLog, column: str) -> tuple[FloatArray, FloatArray]:
    """Return times and values of an IMU column where it has any; empty where it has none.

    Args:
        log: Drive.
        column: Column of its IMU table, there or not.
    """
    if column not in log.imu:
        return np.empty(0), np.empty(0)
    known = log.imu[log.imu[column].notna()]
    return known["t"].to_numpy(np.float64), known[column].to_numpy(np.float64)


def imu_mean(log: DriveLog, column: str, edges: FloatArray, max_gap: float) -> FloatArray:
    """Return the means of an IMU column over consecutive intervals.

    Args:
        log: Drive.
        column: Column of its IMU table; zeros where the log does not have it.
        edges: Ends of the intervals, s, increasing, shape (T+1,).
        max_gap: Longest gap that a straight line may bridge, s.

    Returns:
        Means, in the column's unit, shape (T,).

    Raises:
        LogError: The column has a longer gap.
    """
    t, values = known_samples(log, column)
    if t.size == 0:
        return np.zeros(edges.size - 1)
    start, length = longest_gap(t, float(edges[0]), float(edges[-1]))
    if length > max_gap:
        raise LogError(
            f"{log.metadata.name}: imu column {column} has no value for {length:.2f} s after t = "
            f"{start:.2f} s, more than the {max_gap:g} s that may be bridged; cut the log there "
            "(DriveLog.between), drop the column or raise max_imu_gap"
        )
    return interval_means(t, values, edges, sampling=sampling_of(log, "imu"))
