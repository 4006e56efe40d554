"""What a method may know of a drive when it navigates through an outage: causality by absence.

Real-time methods get the drive up to the outage's end. A post-processing method declares with an
attribute ``sees_after`` how many seconds after the end it may see as well; of what lies inside
the outage it gets no more than the others.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pandas as pd

from navlearn.errors import ConfigError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.schedule import Outage


def known_log(log: DriveLog, outage: Outage, *, after: float = 0.0) -> DriveLog:
    """Return what a method may know for an outage.

    Args:
        log: The whole drive.
        outage: The outage.
        after: How long after the outage's end the method sees fixes and sensors, s; 0 for all
            that navigate in real time.

    Returns:
        The log without fixes and ranges from the outage's start, but for those between its end and
        ``after`` later, and the ranges of the satellites that stay visible; without sensor samples
        after that; without reference, and without what the metadata tell beside their own fields,
        such as the errors of a synthetic gyro.
    """
    last = outage.end + after
    open_sky = log.without_fixes_from(outage.start, visible=outage.satellites_visible)
    known = replace(
        open_sky,
        ranges=None if open_sky.ranges is None else _until(open_sky.ranges, last),
        imu=_until(log.imu, last),
        odometer=_until(log.odometer, last),
        reference=None,
        metadata=replace(log.metadata, extra=_names_of_files(log)),
    )
    if after == 0.0:
        return known
    known = replace(known, fixes=log.fixes[_outside(log.fixes, outage, last)])
    if log.ranges is None:
        return known
    stays = log.ranges["satellite"].isin(outage.satellites_visible) & (log.ranges["t"] <= last)
    return replace(known, ranges=log.ranges[_outside(log.ranges, outage, last) | stays])


def _outside(table: pd.DataFrame, outage: Outage, last: float) -> "pd.Series[bool]":
    t = table["t"]
    return (t < outage.start) | ((t >= outage.end) & (t <= last))


def _names_of_files(log: DriveLog) -> dict[str, Any]:
    """Return what messages need of a log's further metadata."""
    return {name: value for name, value in log.metadata.extra.items() if name == "files"}


def sees_after(method: object) -> float:
    """Return how long after an outage's end a method sees, s; 0 for one that does not say.

    Args:
        method: The method.

    Raises:
        ConfigError: It declares a negative time.
    """
    declared = float(getattr(method, "sees_after", 0.0))
    if not declared >= 0.0:
        raise ConfigError(
            f"{type(method).__name__}.sees_after: found {declared}; give the seconds after an "
            "outage's end that the method may see, or 0 for none"
        )
    return declared


def settings_with_sight(
    methods: Mapping[str, object], settings: Mapping[str, object] | None
) -> dict[str, object]:
    """Return a replay's settings, with what post-processing methods see added to theirs.

    Args:
        methods: By name.
        settings: Per method, the plain values that it was built from.
    """
    told = dict(settings or {})
    for name, method in methods.items():
        if name in told and sees_after(method) > 0.0:
            told[name] = {"settings": told[name], "sees_after": sees_after(method)}
    return told


def _until(table: pd.DataFrame, end: float) -> pd.DataFrame:
    return table[table["t"] <= end]
