"""Whether raw ranges give positions, and which of them do not fit the others."""

from dataclasses import replace

import numpy as np
import pandas as pd
import torch

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.accuracy import errors_against
from navlearn.logs.quality.findings import Part, Severity
from navlearn.logs.quality.range_rates import check_range_rates
from navlearn.logs.quality.receiver_clock import check_receiver_clock
from navlearn.logs.quality.signals import column, in_order
from navlearn.logs.range_checks import checked_ranges
from navlearn.logs.single_point_fixes import (
    ReceptionSolutions,
    fixes_of,
    solve_receptions,
)

_WILD = 1000.0
"""Residual of a range that no street explains, m."""

_FAINT, _STRONG = 20.0, 60.0
"""Between these lies the median C/N0 of any receiver that measures, dB-Hz."""

_REFUSED = 0.5
"""Share of receptions from which a satellite that is refused so often is out of order."""

_FEWEST = 10
"""Receptions below which nothing is said of a satellite."""


def check_ranges(log: DriveLog) -> Part:
    """Check raw ranges by solving every reception; times as they were read."""
    part = Part()
    if log.ranges is None:
        return part
    if log.ranges.empty:
        part.add(
            "error",
            "empty table",
            "ranges",
            "no rows",
            "ranges to satellites",
            "check the reader's files, or leave the table out",
        )
        return part
    _check_twice(part, log.ranges)
    _check_told(part, log.ranges)
    try:
        clean = checked_ranges("ranges", in_order(log.ranges))
        found = solve_receptions(replace(log, ranges=clean))
    except LogError as error:
        part.add(
            "error",
            "ranges unusable",
            "ranges",
            str(error),
            "ranges from which a position can be found",
            "complete the table, or say in range_corrections what has been done to it",
        )
        return part
    _check_solved(part, found)
    _check_wild(part, found)
    _check_refused(part, found)
    _check_positions(part, log, found)
    check_receiver_clock(part, found)
    check_range_rates(part, found)
    return part


def _check_twice(part: Part, ranges: pd.DataFrame) -> None:
    twice = ranges.duplicated(["t", "satellite"]).to_numpy()
    if not twice.any():
        return
    row = int(np.argmax(twice))
    part.add(
        "error",
        "satellite twice",
        f"ranges row {row}",
        f"{np.count_nonzero(twice)} rows repeat a satellite of their reception, first "
        f"{ranges['satellite'].iloc[row]} at {column(ranges, 't')[row]:.2f} s",
        "one range per satellite and reception",
        "keep the first signal of each satellite in the reader",
    )


def _check_told(part: Part, ranges: pd.DataFrame) -> None:
    """Check what the receiver tells of its own signals, which ranges are weighed by."""
    cn0 = column(ranges, "cn0")
    if np.isfinite(cn0).any():
        middle = float(np.nanmedian(cn0))
        part.figures["cn0_median_db_hz"] = middle
        if not _FAINT <= middle <= _STRONG:
            part.add(
                "warning",
                "signal strength",
                "ranges cn0",
                f"{middle:.3g} in the median",
                f"carrier-to-noise densities of {_FAINT:g} to {_STRONG:g} dB-Hz",
                "check its unit (a scale of 0 to 9 is no dB-Hz), or leave the column out",
            )
    for name in ("std_range", "std_rate"):
        negative = np.count_nonzero(column(ranges, name) < 0.0)
        if negative:
            part.add(
                "warning",
                "negative deviation",
                f"ranges {name}",
                f"{negative} of {len(ranges)} rows below zero, where nothing is taken to be told",
                "a deviation, or no value",
                "check the column, or leave it out",
            )


def _check_solved(part: Part, found: ReceptionSolutions) -> None:
    heard = found.series.ranges.has_range.sum(-1).numpy()
    solved = found.points.ok.numpy()
    share = float(np.mean(solved))
    part.figures |= {
        "receptions": float(len(solved)),
        "satellites_per_reception": float(np.mean(heard)),
        "receptions_under_four_satellites_share": float(np.mean(heard < 4)),
        "receptions_solved_share": share,
    }
    if share < 0.5:
        reasons = torch.bincount(found.points.reason, minlength=6).tolist()
        named = ("too few satellites", "geometry", "no convergence", "residuals", "height")
        told = ", ".join(f"{n} {name}" for n, name in zip(reasons[1:], named, strict=True) if n)
        severity: Severity = "error" if share < 0.1 else "warning"
        part.add(
            severity,
            "few positions from ranges",
            "ranges",
            f"{100.0 * share:.0f} % of {len(solved)} receptions give a position ({told})",
            "a position from nearly every reception with five satellites",
            "check satellite positions (unit, Earth rotation), satellite clocks and what "
            "range_corrections says; few satellites alone are no fault: use tight coupling",
        )


def _check_wild(part: Part, found: ReceptionSolutions) -> None:
    sound = found.points.ok.unsqueeze(-1) & (found.series.ranges.has_range > 0.0)
    wild = (sound & (found.points.residual.abs() > _WILD)).numpy()
    total = int(sound.sum())
    count = int(np.count_nonzero(wild))
    part.figures["wild_ranges"] = float(count)
    if count == 0:
        return
    size = np.where(wild, found.points.residual.abs().numpy(), 0.0)
    row, slot = np.unravel_index(int(np.argmax(size)), size.shape)
    part.add(
        "error" if count > 0.1 * total else "warning",
        "wild ranges",
        f"ranges at {float(found.series.t[int(row)]):.2f} s",
        f"{count} of {total} ranges over 1 km from the position of their reception, the worst "
        f"{found.series.satellites[int(slot)]} by {size[row, slot] / 1000.0:.1f} km",
        "residuals of metres, of a hundred metres between houses",
        "nothing for single ones, which tests refuse; many are a satellite clock that is missing "
        "or a wrong ephemeris",
    )


def _check_refused(part: Part, found: ReceptionSolutions) -> None:
    points = found.points
    solved = points.ok.unsqueeze(-1)
    judged = ((points.used + points.excluded) > 0.0) & solved & (points.degrees > 0).unsqueeze(-1)
    refused = (judged & (points.excluded > 0.0)).sum(0).numpy()
    times = judged.sum(0).numpy()
    part.figures["ranges_refused_share"] = float(refused.sum() / max(1, times.sum()))
    always = [
        f"{name} ({refused[k]} of {times[k]})"
        for k, name in enumerate(found.series.satellites)
        if times[k] >= _FEWEST and refused[k] > _REFUSED * times[k]
    ]
    if always:
        part.add(
            "warning",
            "satellites refused",
            "ranges",
            f"refused in most receptions: {', '.join(always)}",
            "a satellite that fits the others, now and then refused",
            "look at its health and ephemeris; leave it out with RangeOptions(without=...)",
        )


def _check_positions(part: Part, log: DriveLog, found: ReceptionSolutions) -> None:
    other = log.reference if log.reference is not None else log.fixes
    fixes = fixes_of(found)
    if len(other) < 3 or len(fixes) < 3:
        part.not_observable["single_point_error_median_m"] = (
            "neither reference nor fixes to compare positions from ranges with"
            if len(other) < 3
            else "under three receptions could be solved"
        )
        return
    _, east, north, up = errors_against(fixes, other)
    error = np.hypot(east, north)
    known = np.isfinite(error)
    if np.count_nonzero(known) < 3:
        part.not_observable["single_point_error_median_m"] = (
            "no reception lies within the time of reference or fixes"
        )
        return
    median, most = (float(np.quantile(error[known], q)) for q in (0.5, 0.95))
    part.figures |= {"single_point_error_median_m": median, "single_point_error_95_m": most}
    if np.isfinite(up[known]).any():
        part.figures["single_point_height_offset_m"] = float(np.nanmedian(up[known]))
    if median > 100.0:
        part.add(
            "error",
            "ranges beside the track",
            "ranges",
            f"positions from ranges lie {median:.0f} m (median) from "
            f"{'the reference' if other is log.reference else 'the fixes'}",
            "metres, tens of metres between houses",
            "check clock (leap seconds shift a car, and satellites by 4 km/s), Earth rotation and "
            "satellite clocks in range_corrections",
        )
