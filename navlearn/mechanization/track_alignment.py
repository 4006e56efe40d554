"""Alignment of a car whose fixes have no velocity: its way is laid onto their positions.

Single-point solutions of ranges without Doppler are scattered by metres and tell no course. The way
that gyro and odometer tell keeps its shape, so it is laid onto the positions of the drive so far,
further and further, until its azimuth is known well enough to start a filter.
"""

import math

import torch
from torch import Tensor

from navlearn import earth, wgs84
from navlearn.errors import LogError
from navlearn.mechanization.alignment import (
    Alignment,
    AlignmentOptions,
    align_from_course,
    gyro_bias_at_rest,
)
from navlearn.mechanization.track_fit import Positions, Prior, TrackFit, Way, fit_track
from navlearn.states import FixTiming, GnssFix, NavState, RissSample


def align_riss(
    samples: RissSample, fixes: GnssFix, timing: FixTiming, options: AlignmentOptions
) -> Alignment:
    """Return the first state from which a filter can run, by course or by the way driven.

    The way driven is asked only where no fix has a velocity.

    Args:
        samples: Intervals, shape (T,) each.
        fixes: Fixes, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        options: Thresholds and standard deviations.

    Raises:
        LogError: There are no fixes, or they tell no azimuth.
    """
    usable = timing.index >= 0
    if bool((usable & (fixes.has_velocity > 0)).any()):
        return align_from_course(samples, fixes, timing, options)
    if not bool((usable & (fixes.has_position > 0)).any()):
        raise LogError(
            "alignment: no fix to start from; where the log has raw ranges, make fixes of them "
            "first (with_single_point_fixes), or from a reference (log.aiding of a recipe)"
        )
    return align_from_track(samples, fixes, timing, options)


def align_from_track(
    samples: RissSample, fixes: GnssFix, timing: FixTiming, options: AlignmentOptions
) -> Alignment:
    """Return position and azimuth at the end of the shortest way that tells them.

    Nothing after that end is looked at. The car must have driven forward all the while.

    Args:
        samples: Intervals, shape (T,) each.
        fixes: Fixes with positions, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        options: What is known of the sensors; ``track`` tells how long a way must be.

    Raises:
        LogError: The whole drive tells no azimuth.
    """
    clock = torch.cumsum(samples.dt, 0)
    driven = torch.cumsum(samples.speed * samples.dt, 0)
    heard = torch.nonzero((timing.index >= 0) & (fixes.has_position > 0))[:, 0]
    smallest, longest, tried = float("inf"), 0.0, float("-inf")
    for place in range(options.track.least_fixes - 1, len(heard)):
        end = int(timing.index[heard[place]])
        if float(clock[end]) - tried < options.track.every:
            continue
        begin = float(clock[end]) - options.track.longest
        used = heard[: place + 1]
        used = used[clock[timing.index[used]] >= begin]
        first = int(timing.index[used[0]])
        way = float(driven[end] - driven[first])
        longest = max(longest, way)
        if len(used) < options.track.least_fixes or way < options.track.least_way:
            continue
        if float(clock[end] - clock[first]) < options.track.least_time:
            continue
        tried = float(clock[end])
        found = _fitted(samples, fixes, timing, used, clock, options)
        smallest = min(smallest, found.azimuth_sigma)
        if found.azimuth_sigma <= options.track.azimuth_sigma:
            return found
    raise LogError(
        f"alignment: no fix has a velocity, and the way driven ({longest:.0f} m at most within "
        f"{options.track.longest:g} s) tells the azimuth to {smallest:.3g} rad at best where "
        f"{options.track.azimuth_sigma:.3g} rad are asked; give a longer stretch of driving before "
        "the first outage, or raise AlignmentOptions.track.azimuth_sigma"
    )


def _fitted(
    samples: RissSample,
    fixes: GnssFix,
    timing: FixTiming,
    used: Tensor,
    clock: Tensor,
    options: AlignmentOptions,
) -> Alignment:
    """Return what the fixes ``used`` and the way between the first and last of them tell."""
    first, end = int(timing.index[used[0]]), int(timing.index[used[-1]])
    last = used[-1]
    lat, lon, height = fixes.lat[last], fixes.lon[last], fixes.height[used].median()
    bias, rest = gyro_bias_at_rest(samples, lat, end + 1)
    enough = rest >= options.standstill
    sigma = options.bias_sigma_at_rest if enough else options.bias_sigma
    prior = Prior(bias if enough else 0.0, sigma, options.track.scale_sigma)
    inside = slice(first, end + 1)
    way = Way(
        samples.dt[inside],
        wgs84.EARTH_RATE * torch.sin(lat) - samples.yaw_rate[inside],
        samples.speed[inside],
    )
    begin = clock[first] - samples.dt[first]
    seen = _positions(fixes, timing, used, clock - begin, (lat, lon, height))
    found = fit_track(
        way,
        seen,
        prior,
        huber=options.track.huber,
        correlation_time=options.track.correlation_time,
    )
    return _alignment(found, fixes, used, end, (lat, lon, height))


def _positions(
    fixes: GnssFix,
    timing: FixTiming,
    used: Tensor,
    clock: Tensor,
    origin: tuple[Tensor, Tensor, Tensor],
) -> Positions:
    time = (clock[timing.index[used]] - timing.delay[used]).clamp(min=0.0)
    lat, lon, _ = origin
    by_lat, by_lon = _metres_per_radian(origin)
    around = fixes.lon[used] - lon
    around = around - torch.round(around * (0.5 / math.pi)) * (2.0 * math.pi)
    # meridians converge: the mean of both latitudes counts
    narrowing = torch.cos(0.5 * (fixes.lat[used] + lat)) / torch.cos(lat)
    east, north = around * by_lon * narrowing, (fixes.lat[used] - lat) * by_lat
    sigma = torch.sqrt(0.5 * (fixes.std_e[used] ** 2 + fixes.std_n[used] ** 2))
    return Positions(time, east, north, sigma)


def _alignment(
    found: TrackFit,
    fixes: GnssFix,
    used: Tensor,
    end: int,
    origin: tuple[Tensor, Tensor, Tensor],
) -> Alignment:
    by_lat, by_lon = _metres_per_radian(origin)
    lat, lon, height = origin[0] + found.north / by_lat, origin[1] + found.east / by_lon, origin[2]
    deviation = found.covariance.diagonal().sqrt()
    # What all positions have in common, such as what is left of the ionosphere, does not average.
    common = float(torch.maximum(fixes.std_e[used], fixes.std_n[used]).median())
    scatter = 1.4826 * float(torch.abs(fixes.height[used] - height).median())
    return Alignment(
        sample=end,
        state=NavState(lat, lon, height, found.azimuth),
        azimuth_sigma=float(deviation[2]),
        position_sigma=max(float(deviation[:2].max()), common),
        height_sigma=max(float(fixes.std_u[used].median()), scatter),
        gyro_bias=float(found.gyro_bias),
        gyro_bias_sigma=float(deviation[3]),
    )


def _metres_per_radian(origin: tuple[Tensor, Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Return how far a radian of latitude and one of longitude lead around a place, m."""
    lat, _, height = origin
    around = (earth.prime_vertical_radius(lat) + height) * torch.cos(lat)
    return earth.meridian_radius(lat) + height, around
