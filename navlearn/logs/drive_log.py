"""One drive: its sensors' tables at their own rates, and what is known about them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import pandas as pd


@dataclass(frozen=True, kw_only=True)
class StatedStart:
    """Where and how the car was at the beginning of a log's first interval, where that is known.

    Most logs do not know it and are aligned by their fixes; a simulated scenario may state it.

    Attributes:
        lat: Latitude, rad.
        lon: Longitude, rad.
        height: Height above the ellipsoid, m.
        v_e: Velocity to the east, m/s.
        v_n: Velocity to the north, m/s.
        v_u: Velocity up, m/s.
        azimuth: Azimuth of the forward axis, rad.
        pitch: Pitch, rad, nose up positive.
        roll: Roll, rad, right side down positive.
    """

    lat: float
    lon: float
    height: float
    v_e: float
    v_n: float
    v_u: float
    azimuth: float
    pitch: float
    roll: float


@dataclass(frozen=True, kw_only=True)
class LogMetadata:
    """What is known about a drive beside its samples.

    Attributes:
        name: Short name, used in tables and file names.
        source: Where the samples came from (format and files), for messages.
        license: Licence of the data, empty where unknown.
        time_origin: What t = 0 was on the log's own clock, s; add it to get the log's times.
        time_scale: Name of the log's own clock, such as "GPS seconds of week 1485".
        lever_arm: Antenna from the IMU, body frame RFU, m.
        gnss_latency: How late fixes are stamped against the IMU, s; already removed where
            ``latency_removed`` says so.
        odometer_latency: How late odometer samples are stamped against the IMU, s.
        latency_removed: Whether both latencies have already been taken off the times.
        interval_means: Names of the tables whose samples are means over the interval that ends
            at their time; samples of the others hold at the instant of their time.
        sensors: Free text per sensor: make, grade, step, rate.
        start: State of the car at the log's first sample, where it is known.
        range_corrections: What has already been done to the ranges, of
            :data:`navlearn.logs.columns.RANGE_CORRECTIONS`.
        klobuchar: Ionosphere as GPS broadcasts it, α₀ to α₃ and β₀ to β₃; empty where unknown.
        gps_time_origin: What t = 0 was, GPS seconds since 6 January 1980, where it is known.
        is_truth: Whether ``reference`` is simulation truth rather than a better instrument.
        extra: Anything else a reader wishes to keep, as plain values.
    """

    name: str
    source: str = ""
    license: str = ""
    time_origin: float = 0.0
    time_scale: str = ""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gnss_latency: float = 0.0
    odometer_latency: float = 0.0
    latency_removed: bool = False
    interval_means: tuple[str, ...] = ()
    sensors: Mapping[str, str] = field(default_factory=dict)
    start: StatedStart | None = None
    range_corrections: tuple[str, ...] = ()
    klobuchar: tuple[float, ...] = ()
    gps_time_origin: float | None = None
    is_truth: bool = False
    extra: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class DriveLog:
    """One drive: tables with the columns of :mod:`navlearn.logs.columns`.

    Attributes:
        imu: Inertial samples.
        odometer: Odometer samples; no rows where the car has no odometer.
        fixes: GNSS solutions.
        reference: A better solution to judge with, or None.
        metadata: What is known beside the samples.
        ranges: Raw GNSS ranges, or None.
    """

    imu: pd.DataFrame
    odometer: pd.DataFrame
    fixes: pd.DataFrame
    reference: pd.DataFrame | None
    metadata: LogMetadata
    ranges: pd.DataFrame | None = None

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return the tables that the log has, by name."""
        found = {"imu": self.imu, "odometer": self.odometer, "fixes": self.fixes}
        if self.reference is not None:
            found["reference"] = self.reference
        if self.ranges is not None:
            found["ranges"] = self.ranges
        return found

    @property
    def duration(self) -> float:
        """Length of the drive by its IMU, s."""
        return float(self.imu["t"].iloc[-1] - self.imu["t"].iloc[0])

    def between(self, start: float, stop: float) -> "DriveLog":
        """Return the part of the drive with start <= t < stop, times unchanged.

        A stated start goes with a part that begins with the whole.

        Args:
            start: First time kept, s.
            stop: First time no longer kept, s.
        """

        def cut(table: pd.DataFrame) -> pd.DataFrame:
            return table[(table["t"] >= start) & (table["t"] < stop)].reset_index(drop=True)

        part = self.with_tables({name: cut(table) for name, table in self.tables().items()})
        if part.metadata.start is None or part.imu["t"].iloc[:1].equals(self.imu["t"].iloc[:1]):
            return part
        return replace(part, metadata=replace(part.metadata, start=None))

    def with_tables(self, tables: Mapping[str, pd.DataFrame]) -> "DriveLog":
        """Return the log with some tables replaced.

        Args:
            tables: New tables by name; those not named stay.
        """
        every = {**self.tables(), **tables}
        return DriveLog(
            imu=every["imu"],
            odometer=every["odometer"],
            fixes=every["fixes"],
            reference=every.get("reference"),
            metadata=self.metadata,
            ranges=every.get("ranges"),
        )

    def without_fixes_from(self, start: float, *, visible: tuple[str, ...] = ()) -> "DriveLog":
        """Return the log in which no fix at or after a time exists, and no range but of some.

        Args:
            start: Time from which fixes and ranges are taken away, s.
            visible: Satellites whose ranges stay, such as ``G07``.
        """
        ranges = self.ranges
        if ranges is not None:
            ranges = ranges[(ranges["t"] < start) | ranges["satellite"].isin(visible)]
        return replace(self, fixes=self.fixes[self.fixes["t"] < start], ranges=ranges)
