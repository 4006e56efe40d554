"""From a format's tables to a checked drive log: axes, datum, latencies, origin of time."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.axes import turned
from navlearn.logs.clock import (
    from_first_sample,
    section,
    without_backsteps,
    without_latency,
    without_repeats,
)
from navlearn.logs.columns import REQUIRED, TABLES
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.reference_latency import without_reference_latency
from navlearn.logs.table_layout import ReferenceLatency
from navlearn.logs.validate import as_numbers, validate_log


@dataclass(frozen=True, kw_only=True)
class Published:
    """What a format's reader found: canonical columns, SI, but in sensor axes and own times.

    Attributes:
        tables: Tables by canonical name.
        files: File that each table came from, for messages.
        source: Format and folder.
        axes: Where the sensor's x, y and z point by the format's own convention.
        geoid_height: Height of the geoid above the ellipsoid to add to the fixes' heights, m.
        time_scale: Name of the log's own clock.
        interval_means: Tables whose samples are means over the interval ending at their time.
        extra: Anything else worth keeping.
        range_corrections: What has already been done to the ranges.
        klobuchar: Ionosphere as GPS broadcasts it, α₀ to α₃ and β₀ to β₃.
        gps_time_origin: What t = 0 of the log's own clock was, GPS seconds.
    """

    tables: Mapping[str, pd.DataFrame]
    files: Mapping[str, str]
    source: str
    axes: str = "RFU"
    geoid_height: float = 0.0
    time_scale: str = ""
    interval_means: tuple[str, ...] = ()
    extra: Mapping[str, object] = field(default_factory=dict)
    range_corrections: tuple[str, ...] = ()
    klobuchar: tuple[float, ...] = ()
    gps_time_origin: float | None = None


def assemble(published: Published, descriptor: Descriptor) -> DriveLog:
    """Return a checked drive log in the package's frames, units and time.

    Where a reader found no odometer the log's table is empty: a full IMU can do without. Fixes
    are empty where there are none but a reference, which they can be made from.

    Args:
        published: Tables as a reader found them.
        descriptor: What is known beside the files.

    Raises:
        LogError: A table is missing or cannot be used as it is.
        ConfigError: The descriptor's axes are no right-handed triad.
    """
    tables = {
        name: as_numbers(published.files.get(name, name), table)
        for name, table in published.tables.items()
    }
    _require_tables(published, tables)
    for name in ("odometer", "fixes"):
        tables.setdefault(name, without_rows(name))
    if descriptor.on_backstep == "drop":
        tables = {
            name: without_repeats(table) if name == "ranges" else without_backsteps(table)
            for name, table in tables.items()
        }
    tables["imu"] = turned(tables["imu"], descriptor.body_from_sensor(published.axes))
    geoid = descriptor.geoid_height
    tables["fixes"] = _ellipsoidal(
        tables["fixes"], published.geoid_height if geoid is None else geoid
    )
    fixes = without_empty_fixes(tables["fixes"])
    if fixes.empty and len(tables["fixes"]):
        raise LogError(
            f"{published.files.get('fixes', 'fixes')}: none of its {len(tables['fixes'])} rows "
            "holds a position or a velocity; a drive without GNSS can be neither started nor aided"
        )
    log = DriveLog(
        imu=_ordered("imu", tables["imu"]),
        odometer=_ordered("odometer", tables["odometer"]),
        fixes=_ordered("fixes", fixes),
        reference=_ordered("reference", tables["reference"]) if "reference" in tables else None,
        ranges=_ordered("ranges", tables["ranges"]) if "ranges" in tables else None,
        metadata=_metadata(published, descriptor),
    )
    checked = validate_log(section(log, descriptor.section_s))
    if checked.reference is not None:
        moved = without_reference_latency(checked.reference, descriptor.reference_latency)
        checked = checked.with_tables({"reference": moved})
    return from_first_sample(without_latency(checked))


def without_rows(name: str) -> pd.DataFrame:
    """Return the table of a sensor that a drive lacks: its required columns and no rows.

    Args:
        name: Canonical name of the table.
    """
    return pd.DataFrame(columns=["t", *REQUIRED[name]], dtype=np.float64)


def without_empty_fixes(fixes: pd.DataFrame) -> pd.DataFrame:
    """Return the fixes that hold a position or a velocity: a receiver without a fix says nothing.

    Args:
        fixes: Fixes; latitude or longitude may be missing.
    """
    if not {"lat", "lon"} <= set(fixes):
        return fixes
    empty = fixes["lat"].isna() & fixes["lon"].isna()
    if {"v_e", "v_n"} <= set(fixes):
        empty &= fixes["v_e"].isna() | fixes["v_n"].isna()
    return fixes[~empty].reset_index(drop=True)


def _require_tables(published: Published, tables: Mapping[str, pd.DataFrame]) -> None:
    found = ", ".join(tables) or "none"
    if "imu" not in tables:
        raise LogError(
            f"{published.source}: no table imu, which every drive log needs (found: {found}); it "
            f"has the columns t, {', '.join(REQUIRED['imu'])}"
        )
    if not {"fixes", "reference", "ranges"} & set(tables):
        raise LogError(
            f"{published.source}: no table fixes, ranges or reference (found: {found}); a drive "
            "needs GNSS fixes, or ranges or a reference that they can be made from"
        )


def _ellipsoidal(fixes: pd.DataFrame, geoid_height: float) -> pd.DataFrame:
    if "height" not in fixes or geoid_height == 0.0:
        return fixes
    return fixes.assign(height=fixes["height"] + geoid_height)


def _ordered(name: str, table: pd.DataFrame) -> pd.DataFrame:
    known = [column for column in ("t", *TABLES[name]) if column in table]
    others = [column for column in table if column not in known]
    return table[known + others]


def _metadata(published: Published, descriptor: Descriptor) -> LogMetadata:
    return LogMetadata(
        name=descriptor.name,
        source=published.source,
        license=descriptor.license,
        time_scale=descriptor.time_scale or published.time_scale,
        lever_arm=descriptor.lever_arm,
        gnss_latency=descriptor.gnss_latency,
        odometer_latency=descriptor.odometer_latency,
        interval_means=published.interval_means,
        sensors=dict(descriptor.sensors),
        extra={"files": dict(published.files), **_removed(descriptor), **published.extra},
        **_of_ranges(published, descriptor),
    )


def _of_ranges(published: Published, descriptor: Descriptor) -> dict[str, Any]:
    """Return what the descriptor says of raw ranges, and where it says nothing the format."""
    names = ("range_corrections", "klobuchar", "gps_time_origin")
    stated = {name: getattr(descriptor, name) for name in names}
    return {
        name: getattr(published, name) if value is None else value for name, value in stated.items()
    }


def _removed(descriptor: Descriptor) -> dict[str, object]:
    latency = descriptor.reference_latency
    if latency == ReferenceLatency():
        return {}
    return {"reference_latency_removed": latency.model_dump()}
