"""Which ranges could come from satellites at all, before anything is solved."""

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.states import SatelliteRanges

_LOWEST_ORBIT, _HIGHEST_ORBIT = 1.5e7, 1.0e8
"""Distances from the Earth's centre between which navigation satellites fly, m."""

_FASTEST = 1.0e4
"""No satellite moves faster against the Earth, m/s."""

_LARGEST = 1.0e10
"""A pseudorange beyond this is no time of travel, whatever the clock, m."""


def usable_ranges(ranges: SatelliteRanges, elevation_mask: float) -> Tensor:
    """Tell which pseudoranges may take part in a position.

    Refused are what ``has_range`` denies, what is not finite, a satellite that is in no orbit
    (as where its ephemeris is missing), one below the mask, and a range that no place on the
    Earth explains beside the others of its system: pseudorange less distance from the Earth's
    centre spans less than the Earth's radius over all that a receiver can see.

    Args:
        ranges: Receptions, shape (..., S).
        elevation_mask: Lowest elevation, rad.

    Returns:
        Mask, bool, shape (..., S).
    """
    usable = _sighted(ranges, ranges.has_range, elevation_mask)
    usable = usable & torch.isfinite(ranges.pseudorange)
    usable = usable & (ranges.pseudorange.abs() < _LARGEST)
    from_centre = torch.linalg.vector_norm(ranges.satellite, dim=-1)
    excess = ranges.pseudorange - from_centre
    return usable & _near_median(excess, usable, ranges.system, wgs84.SEMI_MAJOR_AXIS)


def usable_rates(ranges: SatelliteRanges, elevation_mask: float) -> Tensor:
    """Tell which range rates may take part in a velocity.

    As :func:`usable_ranges`, with ``has_rate`` and without the last test.

    Args:
        ranges: Receptions, shape (..., S).
        elevation_mask: Lowest elevation, rad.

    Returns:
        Mask, bool, shape (..., S).
    """
    usable = _sighted(ranges, ranges.has_rate, elevation_mask)
    speed = torch.linalg.vector_norm(ranges.satellite_velocity, dim=-1)
    moving: Tensor = usable & torch.isfinite(ranges.range_rate) & (speed < _FASTEST)
    return moving


def weights_of(variance: Tensor, usable: Tensor) -> Tensor:
    """Return inverse variances of what is usable, 0 for the rest and where there is no variance.

    Args:
        variance: Variance of each observation, shape (...).
        usable: Mask, bool, shape (...).

    Returns:
        Weights, shape (...).
    """
    sound = usable & torch.isfinite(variance) & (variance > 0.0)
    return torch.where(sound, 1.0 / torch.where(sound, variance, 1.0), 0.0)


def _sighted(ranges: SatelliteRanges, has: Tensor, elevation_mask: float) -> Tensor:
    from_centre = torch.linalg.vector_norm(ranges.satellite, dim=-1)
    in_orbit = (from_centre > _LOWEST_ORBIT) & (from_centre < _HIGHEST_ORBIT)
    sighted: Tensor = (has > 0.0) & in_orbit & (ranges.elevation >= elevation_mask)
    return sighted


def _near_median(values: Tensor, usable: Tensor, system: Tensor, most: float) -> Tensor:
    near = torch.zeros_like(usable)
    for index in range(int(system.max()) + 1 if system.numel() else 0):
        own = usable & (system == index)
        middle = torch.where(own, values, torch.nan).nanmedian(dim=-1, keepdim=True).values
        near |= own & ((values - middle).abs() <= most)
    return near
