"""The times of a drive: origin, latencies, steps back."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog, LogMetadata


def from_first_sample(log: DriveLog) -> DriveLog:
    """Return the log with t = 0 at its first sample; ``time_origin`` takes up the difference.

    Args:
        log: Drive on any clock.
    """
    origin = _origin(log)
    if origin == 0.0:
        return log
    known = log.metadata
    gps = None if known.gps_time_origin is None else known.gps_time_origin + origin
    metadata = replace(known, time_origin=known.time_origin + origin, gps_time_origin=gps)
    return _shifted(log, dict.fromkeys(log.tables(), -origin), metadata)


def section(log: DriveLog, span: tuple[float | None, float | None]) -> DriveLog:
    """Return the part of a drive between two times after its first sample.

    Args:
        log: Drive on any clock.
        span: First second kept and first no longer kept; None for the drive's own begin or end.

    Raises:
        LogError: No IMU sample lies there.
    """
    if span == (None, None):
        return log
    start = -math.inf if span[0] is None else _origin(log) + span[0]
    stop = math.inf if span[1] is None else _origin(log) + span[1]
    part = log.between(start, stop)
    if part.imu.empty:
        raise LogError(
            f"{log.metadata.name}: section_s: no IMU sample from {start:.2f} to {stop:.2f} s of "
            f"{_origin(log):.2f} to {float(log.imu['t'].iloc[-1]):.2f} s; correct the section"
        )
    return part


def without_latency(log: DriveLog) -> DriveLog:
    """Return the log with its known latencies taken off the times of GNSS and odometer.

    Args:
        log: Drive whose metadata state ``gnss_latency`` and ``odometer_latency``.

    Returns:
        The log itself where nothing is left to remove, else a copy with
        ``latency_removed=True``.
    """
    known = log.metadata
    if known.latency_removed or (known.gnss_latency == 0.0 and known.odometer_latency == 0.0):
        return log
    shifts = {"fixes": -known.gnss_latency, "odometer": -known.odometer_latency}
    if log.ranges is not None:
        shifts["ranges"] = -known.gnss_latency
    return _shifted(log, shifts, replace(known, latency_removed=True))


def without_backsteps(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows whose time is later than every time before them.

    Args:
        table: Table with a column ``t``, s.
    """
    t = table["t"].to_numpy(np.float64)
    latest = np.concatenate(([-np.inf], np.fmax.accumulate(t)[:-1])) if t.size else t
    # Rows without a time stay: the check that follows names them.
    return table.iloc[np.flatnonzero((t > latest) | np.isnan(t))].reset_index(drop=True)


def without_repeats(ranges: pd.DataFrame) -> pd.DataFrame:
    """Return the ranges of receptions that do not step back, each satellite's first in each.

    Args:
        ranges: Table with columns ``t``, s, and ``satellite``.
    """
    t = ranges["t"].to_numpy(np.float64)
    late = t >= np.fmax.accumulate(t) if t.size else np.zeros(0, dtype=np.bool_)
    kept = ranges.iloc[np.flatnonzero(late | np.isnan(t))]
    if "satellite" in kept:
        kept = kept.drop_duplicates(["t", "satellite"])
    return kept.reset_index(drop=True)


def _origin(log: DriveLog) -> float:
    return min(float(table["t"].iloc[0]) for table in log.tables().values() if len(table))


def _shifted(log: DriveLog, shifts: dict[str, float], metadata: LogMetadata) -> DriveLog:
    tables = log.tables()
    shifted = {name: tables[name].assign(t=tables[name]["t"] + by) for name, by in shifts.items()}
    return replace(log.with_tables(shifted), metadata=metadata)
