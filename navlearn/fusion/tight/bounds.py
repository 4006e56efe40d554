"""What no receiver measures: degrees, kilometres, satellites under the ground."""

import math

import torch
from torch import Tensor

from navlearn.errors import LogError
from navlearn.states import FixTiming, SatelliteRanges

SATELLITE_DISTANCES = (1.0e7, 1.0e8)
"""Nearest and farthest a navigation satellite is from the Earth's centre, m."""

FASTEST_SATELLITE = 1e4
"""Fastest a satellite moves against the Earth, m/s."""

USUAL_RANGES = (1.0e6, 1.0e9)
"""Where the middle one of a drive's pseudoranges lies, m; a clock may be off by seconds."""


def check_ranges(ranges: SatelliteRanges, timing: FixTiming, systems: int) -> None:
    """Refuse ranges that no receiver measures; a single wild one is left to the gate.

    Args:
        ranges: Ranges, shape (B, M, S) each.
        timing: Where the receptions fall, shape (B, M) each.
        systems: Number of satellite systems.

    Raises:
        LogError: If what is said to be measured is not finite, or not in SI units and radians, or
            a satellite is of a system that the filter does not have.
    """
    received = (timing.index >= 0).unsqueeze(-1)
    has_range = (ranges.has_range > 0.5) & received
    has_rate = (ranges.has_rate > 0.5) & received
    there = has_range | has_rate
    used = {
        "satellite": there,
        "satellite_velocity": has_rate,
        "pseudorange": has_range,
        "range_rate": has_rate,
        "elevation": there,
        "cn0": there,
        "std_range": has_range,
        "std_rate": has_rate,
        "has_range": torch.ones_like(there),
        "has_rate": torch.ones_like(there),
    }
    for name, use in used.items():
        _check_finite(name, getattr(ranges, name), use)
    _check_satellites(ranges, there, has_rate)
    _refuse(
        "elevation",
        ranges.elevation,
        there & (ranges.elevation.abs() > 0.5 * math.pi + 1e-6),
        "radians within ±π/2: convert degrees with math.radians",
    )
    for name, use in (("std_range", has_range), ("std_rate", has_rate)):
        std = getattr(ranges, name)
        _refuse(name, std, use & (std < 0.0), "0 where the receiver tells none, or more")
    wrong = there & ((ranges.system < 0) | (ranges.system >= systems))
    _refuse(
        "system", ranges.system, wrong, f"0 to {systems - 1}: build the filter with all its systems"
    )
    _check_usual(ranges, has_range)


def _check_finite(name: str, value: Tensor, use: Tensor) -> None:
    fine = torch.isfinite(value)
    if value.dim() > use.dim():
        fine = fine.all(-1)
    where = "has_range" if name in ("pseudorange", "std_range") else "has_range and has_rate"
    _refuse(name, value, use & ~fine, f"finite values where it is used: set {where} to 0")


def _check_satellites(ranges: SatelliteRanges, there: Tensor, has_rate: Tensor) -> None:
    least, most = SATELLITE_DISTANCES
    distance = ranges.satellite.norm(dim=-1)
    _refuse(
        "satellite",
        distance,
        there & ~((distance > least) & (distance < most)),
        f"{least:g} to {most:g} m from the Earth's centre, in Earth-fixed axes: convert kilometres",
    )
    speed = ranges.satellite_velocity.norm(dim=-1)
    _refuse(
        "satellite_velocity",
        speed,
        has_rate & ~(speed < FASTEST_SATELLITE),
        f"less than {FASTEST_SATELLITE:g} m/s against the Earth: give m/s",
    )


def _check_usual(ranges: SatelliteRanges, has_range: Tensor) -> None:
    for row, (value, use) in enumerate(zip(ranges.pseudorange, has_range, strict=True)):
        if not bool(use.any()):
            continue
        middle = float(value[use].detach().median())
        if not USUAL_RANGES[0] < abs(middle) < USUAL_RANGES[1]:
            raise LogError(
                f"tight filter: the middle one of the pseudoranges of drive {row} is {middle:g}; "
                f"expected a size of {USUAL_RANGES[0]:g} to {USUAL_RANGES[1]:g} m: convert to "
                "metres, and take off the seconds by which the receiver's clock is off"
            )


def _refuse(name: str, value: Tensor, wrong: Tensor, expected: str) -> None:
    if bool(wrong.any()):
        row, m, s = wrong.nonzero()[0].tolist()
        found = value[row, m, s].tolist()
        raise LogError(
            f"tight filter: ranges.{name} of drive {row} is {found} at reception {m}, satellite "
            f"{s}; expected {expected}"
        )
