"""What a navigator can know by the end of an outage: causality by absence."""

from dataclasses import replace

import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.schedule import Outage


def known_log(log: DriveLog, outage: Outage) -> DriveLog:
    """Return what a navigator can know by the end of an outage.

    Args:
        log: The whole drive.
        outage: The outage.

    Returns:
        The log without fixes from the outage's start, without sensor samples after its end,
        without reference.
    """
    return replace(
        log.without_fixes_from(outage.start),
        imu=_until(log.imu, outage.end),
        odometer=_until(log.odometer, outage.end),
        reference=None,
    )


def _until(table: pd.DataFrame, end: float) -> pd.DataFrame:
    return table[table["t"] <= end]
