"""The raw ranges of a drive as tensors, placed on a grid of intervals.

Nothing of a reception depends on a later one: where the receiver is, which tells elevations and
delays, is known from fixes or ranges up to then. Only which satellites have a slot, and which
system comes first, depends on the whole table.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from navlearn.errors import LogError
from navlearn.gnss.earth_rotation import in_axes_of_reception
from navlearn.gnss.sight import sight
from navlearn.logs.clock import without_latency
from navlearn.logs.coarse_positions import Coarse, coarse_from_fixes, coarse_from_ranges, latest
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.fix_tensors import placed_on_grid
from navlearn.logs.interval_means import FloatArray
from navlearn.logs.range_corrections import IN_LOG, delays, turned_to_reception
from navlearn.logs.range_layout import DenseRanges, RangeOptions, laid_out
from navlearn.states import FixTiming, SatelliteRanges

Near = tuple[float, float, float] | pd.DataFrame


@dataclass(frozen=True, kw_only=True)
class RangeSeries:
    """The ranges of one drive on the grid of its samples.

    Attributes:
        satellites: The satellite of each slot, ordered by constellation and number.
        systems: RINEX letters of the constellations; the first has most ranges.
        ranges: What was measured, shape (M, S) each; free of what the broadcast tells.
        timing: Interval at whose end each reception is used, and its delay, shape (M,) each.
        t: When each reception was, s, shape (M,).
        corrections: Where each of the corrections came from: ``in the log``, ``column``,
            ``klobuchar``, ``saastamoinen``, ``rotated`` or ``none``.
    """

    satellites: tuple[str, ...]
    systems: tuple[str, ...]
    ranges: SatelliteRanges
    timing: FixTiming
    t: Tensor
    corrections: Mapping[str, str]


def ranges_of(
    log: DriveLog,
    edges: FloatArray,
    options: RangeOptions | None = None,
    *,
    near: Near | None = None,
) -> RangeSeries:
    """Return the ranges of a drive that fall on a grid, seen from its fixes.

    Args:
        log: Drive.
        edges: Ends of the intervals of a uniform grid, s, shape (T+1,).
        options: Which ranges are used.
        near: As of :func:`ranges_from_table`; None for the drive's own fixes.

    Raises:
        LogError: The drive has no ranges, or they lack the satellites' clocks.
    """
    log = without_latency(log)
    if log.ranges is None:
        raise LogError(
            f"{log.metadata.name}: the log has no raw ranges; use a log with a table ranges "
            "(docs/logs.md) or navigate by its fixes"
        )
    if near is None and len(log.fixes):
        near = log.fixes
    return ranges_from_table(log.ranges, log.metadata, edges, options, near)


def ranges_from_table(
    table: pd.DataFrame,
    metadata: LogMetadata,
    edges: FloatArray,
    options: RangeOptions | None = None,
    near: Near | None = None,
) -> RangeSeries:
    """Return the ranges that fall on a grid, corrected for what the broadcast tells.

    A reception is used at the nearest end of an interval. Those before the grid, or more than
    half an interval after it, are left out. Of the corrections those are made that
    ``metadata.range_corrections`` does not name. As long as no position is known, from fixes or
    from a reception of enough satellites, no range is used.

    Args:
        table: Columns of :data:`navlearn.logs.columns.RANGES`, checked.
        metadata: What has been done to the ranges, and what the broadcast tells.
        edges: Ends of the intervals of a uniform grid, s, shape (T+1,).
        options: Which ranges are used.
        near: Where the receiver is, to a few kilometres: latitude, longitude (rad) and height
            (m), or a table with ``t``, ``lat``, ``lon`` and ``height`` such as the fixes, whose
            last row up to a reception counts; None to find it from the ranges.

    Raises:
        LogError: Satellite clocks have not been taken off and are not told.
    """
    chosen = options or RangeOptions()
    satellites, systems, dense = laid_out(table, chosen)
    system = torch.tensor([systems.index(name[0]) for name in satellites], dtype=torch.int64)
    pseudorange, rate, sources = _clocks_off(dense, metadata)
    rotated = "earth_rotation" in metadata.range_corrections
    satellite, velocity = dense.triad("sat_"), dense.triad("sat_v")
    heard = dense.heard * pseudorange.isfinite()
    pseudorange = pseudorange.nan_to_num(0.0)
    known, place = _places(near, dense.t, satellite, pseudorange, heard, system, rotated)
    if not rotated:
        satellite, velocity = turned_to_reception(satellite, velocity, *place)
    seen = sight(*place, satellite)
    letters = tuple(name[0] for name in satellites)
    t = torch.from_numpy(dense.t)
    late = delays(dense.columns, metadata, t, place, seen, letters)
    cn0 = dense.told("cn0", chosen.unknown_cn0)
    used = heard * known.unsqueeze(-1)
    used = used * (seen.elevation >= chosen.least_elevation) * (cn0 >= chosen.least_cn0)
    moving = (velocity != 0.0).any(-1) * rate.isfinite()
    kept, timing = placed_on_grid(dense.t, edges)
    inside = torch.from_numpy(kept)
    ranges = SatelliteRanges(
        satellite,
        velocity,
        torch.where(heard > 0.0, pseudorange - late.ionosphere - late.troposphere, 0.0),
        rate.nan_to_num(0.0),
        seen.elevation,
        cn0,
        dense.told("std_range", 0.0),
        dense.told("std_rate", 0.0),
        system,
        used,
        used * moving,
    )
    return RangeSeries(
        satellites=satellites,
        systems=systems,
        ranges=SatelliteRanges(*(part if part is system else part[inside] for part in ranges)),
        timing=timing,
        t=t[inside],
        corrections={
            **sources,
            **late.sources,
            "earth_rotation": IN_LOG if rotated else "rotated",
        },
    )


def _clocks_off(dense: DenseRanges, metadata: LogMetadata) -> tuple[Tensor, Tensor, dict[str, str]]:
    """Return pseudoranges and range rates free of the satellites' clocks."""
    pseudorange = dense.columns["pseudorange"]
    rate = dense.columns.get("range_rate", torch.full_like(pseudorange, torch.nan))
    if "satellite_clock" in metadata.range_corrections:
        return pseudorange, rate, {"satellite_clock": IN_LOG}
    if "sat_clock" not in dense.columns:
        raise LogError(
            f"{metadata.name}: ranges have no column sat_clock, and range_corrections does not "
            "name satellite_clock: a satellite's clock is wrong by up to 300 km; give the column, "
            "or range_corrections: [satellite_clock] where the values are free of it"
        )
    drift = dense.columns.get("sat_clock_rate", torch.zeros_like(rate)).nan_to_num(0.0)
    return pseudorange + dense.columns["sat_clock"], rate + drift, {"satellite_clock": "column"}


def _places(
    near: Near | None,
    t: FloatArray,
    satellite: Tensor,
    pseudorange: Tensor,
    heard: Tensor,
    system: Tensor,
    rotated: bool,
) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
    """Return 1.0 where a position was known at a reception, and latitude, longitude, height."""
    if isinstance(near, tuple):
        place = [torch.full((t.size,), value, dtype=torch.float64) for value in near]
        return torch.ones(t.size, dtype=torch.float64), (place[0], place[1], place[2])
    if not rotated:  # a signal travels for 0.067 to 0.09 s, where it comes from on Earth's orbits
        satellite = in_axes_of_reception(satellite, torch.full_like(heard, 0.075))
    found = coarse_from_ranges(t, satellite, pseudorange, heard, system)
    if near is not None:
        found = _fixes_first(coarse_from_fixes(near), found)
    known, coarse = latest(found, t)
    at = [torch.tensor(part) for part in coarse[1:]]
    return torch.tensor(known), (at[0], at[1], at[2])


def _fixes_first(fixes: Coarse, solved: Coarse) -> Coarse:
    """Return fixes, and before the first of them what ranges told."""
    before = solved.t < (fixes.t[0] if fixes.t.size else np.inf)
    return Coarse(
        *(np.concatenate((part[before], own)) for part, own in zip(solved, fixes, strict=True))
    )
