"""Fixes for a log that has raw ranges alone: one single-point solution per reception.

With them all that is loosely coupled works on such a log. Each reception is solved by itself,
so that no fix knows of a later one.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch

from navlearn.errors import LogError
from navlearn.gnss.range_rate_velocity import RangeRateVelocity, range_rate_velocity
from navlearn.gnss.single_point import SinglePoint, single_point
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.range_tensors import RangeSeries, ranges_from_table


@dataclass(frozen=True, kw_only=True)
class SinglePointFixOptions:
    """How fixes are made of ranges.

    Attributes:
        ranges: Which ranges are used.
        single_point: How positions and velocities are solved and tested.
    """

    ranges: RangeOptions = field(default_factory=RangeOptions)
    single_point: SinglePointOptions = field(default_factory=SinglePointOptions)


class ReceptionSolutions(NamedTuple):
    """Positions and velocities at every reception of a log.

    Attributes:
        series: The ranges, shape (M, S).
        points: Positions, shape (M).
        velocities: Velocities at these positions, shape (M); not ok where the position is not.
    """

    series: RangeSeries
    points: SinglePoint
    velocities: RangeRateVelocity


def with_single_point_fixes(
    log: DriveLog, options: SinglePointFixOptions | None = None
) -> DriveLog:
    """Return the log with fixes from its raw ranges, in place of what fixes it had.

    A reception without a position that passed its tests gives no fix; one without a velocity
    gives a fix without velocity.

    Args:
        log: Log with ranges.
        options: How fixes are made.

    Raises:
        LogError: The log has no ranges, or no reception could be solved.
    """
    found = solve_receptions(log, options)
    kept = found.points.ok.numpy()
    if not kept.any():
        raise LogError(
            f"{log.metadata.name}: none of {kept.size} receptions gave a position (satellites "
            f"per reception: {_satellites(found)}); check the ranges with navlearn check"
        )
    return log.with_tables({"fixes": fixes_of(found)})


def solve_receptions(
    log: DriveLog, options: SinglePointFixOptions | None = None
) -> ReceptionSolutions:
    """Return position and velocity at each reception of a log, each by itself.

    Args:
        log: Log with ranges.
        options: How they are solved.

    Raises:
        LogError: The log has no ranges, or they lack the satellites' clocks.
    """
    options = options or SinglePointFixOptions()
    if log.ranges is None or log.ranges.empty:
        raise LogError(
            f"{log.metadata.name}: the log has no raw ranges to make fixes of; use a log with a "
            "table ranges (docs/logs.md)"
        )
    t = log.ranges["t"].to_numpy(np.float64)
    around = np.array([t[0] - 1.0, t[-1] + 1.0])
    series = ranges_from_table(log.ranges, log.metadata, around, options.ranges)
    with torch.no_grad():
        points = single_point(series.ranges, options.single_point, systems=len(series.systems))
        place = (points.lat, points.lon, points.height)
        velocities = range_rate_velocity(series.ranges, place, options.single_point)
    velocities = velocities._replace(ok=velocities.ok & points.ok)
    return ReceptionSolutions(series, points, velocities)


def _satellites(found: ReceptionSolutions) -> str:
    heard = found.series.ranges.has_range.sum(-1)
    return f"{int(heard.min())} to {int(heard.max())}"


def fixes_of(found: ReceptionSolutions) -> pd.DataFrame:
    """Return the table of fixes of the receptions that were solved.

    Where the residuals of a reception are larger than was expected of them, deviations are taken
    to be as much larger: √(χ² / degrees), never below one. With no satellite to spare nothing is
    known of residuals, and what was expected stands.

    Args:
        found: Solutions of all receptions.

    Returns:
        Columns of :data:`navlearn.logs.columns.FIXES`; velocities only where there are some.
    """
    points, velocities = found.points, found.velocities
    deviation = points.covariance.diagonal(dim1=-2, dim2=-1).sqrt() * _larger(points)
    columns = {
        "t": found.series.t,
        "lat": points.lat,
        "lon": points.lon,
        "height": points.height,
    }
    told = velocities.ok
    if bool(told.any()):
        for axis, name in enumerate(("v_e", "v_n", "v_u")):
            columns[name] = torch.where(told, velocities.v_l[:, axis], torch.nan)
    for axis, name in enumerate(("std_e", "std_n", "std_u")):
        columns[name] = deviation[:, axis]
    if bool(told.any()):
        level = velocities.covariance.diagonal(dim1=-2, dim2=-1)[:, :2].mean(-1, keepdim=True)
        level = (level.sqrt() * _larger(velocities)).squeeze(-1)
        columns["std_v"] = torch.where(told, level, torch.nan)
    columns["satellites"] = points.satellites.double()
    kept = points.ok
    return pd.DataFrame({name: value[kept].numpy() for name, value in columns.items()})


def _larger(found: SinglePoint | RangeRateVelocity) -> torch.Tensor:
    """Return by how much residuals are larger than expected, at least 1, shape (M, 1)."""
    factor = torch.where(found.degrees > 0, found.test / found.degrees.clamp_min(1), 1.0)
    return factor.clamp_min(1.0).sqrt().unsqueeze(-1)
