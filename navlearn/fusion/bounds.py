"""What no drive can hold: time that runs back, fixes of the future, noise that is none, degrees."""

import math

import torch
from torch import Tensor

from navlearn.errors import LogError
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample

LONGEST_SAMPLE = 1.0
"""Longest interval of a sample, s; what a car does within one is not told by its mean."""

OLDEST_FIX = 5.0
"""Longest delay of a fix, s; further back a car's motion is not that of the sample at hand."""


def check_bounds(
    samples: RissSample | ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    place: tuple[Tensor, Tensor],
) -> None:
    """Refuse finite values that no drive can hold.

    Args:
        samples: Samples, shape (B, T) each, vectors (B, T, 3).
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.
        place: Latitude and longitude at the start, rad, shape (B,) each.

    Raises:
        LogError: If a sample has negative or great length, a fix comes before it was valid or
            long after, a valid fix states no positive deviation, or a place is not in radians.
    """
    check_lengths(samples.dt)
    used = timing.index >= 0
    _check_delays(samples.dt, timing.delay, used)
    has_position = used & (fixes.has_position > 0.5)
    has_velocity = used & (fixes.has_velocity > 0.5)
    for name in ("std_e", "std_n", "std_u", "std_v"):
        told = has_velocity if name == "std_v" else has_position
        _check_deviation(name, getattr(fixes, name), told)
    start = torch.ones_like(place[0], dtype=torch.bool)
    _check_radians("start.state", place[0], place[1], start)
    _check_radians("fixes", fixes.lat, fixes.lon, has_position)


def check_lengths(dt: Tensor) -> None:
    """Refuse samples of negative or great length.

    Args:
        dt: Length of the intervals, s, shape (B, T); zero pads.

    Raises:
        LogError: If there is one.
    """
    wrong = (dt < 0.0) | (dt > LONGEST_SAMPLE + 1e-6)
    if bool(wrong.any()):
        row, k = wrong.nonzero()[0].tolist()
        found = float(dt[row, k])
        advice = (
            "sort the samples by time"
            if found < 0.0
            else "cut the drive at the gap, or resample it to shorter intervals"
        )
        raise LogError(
            f"filter: samples.dt of drive {row} is {found:g} s at sample {k}; expected 0 (padding) "
            f"to {LONGEST_SAMPLE:g} s: {advice}"
        )


def _check_delays(dt: Tensor, delay: Tensor, used: Tensor) -> None:
    # a fix is used at the end nearest to it, which may lie just before it
    ahead = dt.amax(1, keepdim=True) if dt.shape[1] else dt.new_zeros((len(dt), 1))
    wrong = used & ((delay < -(ahead + 1e-6)) | (delay > OLDEST_FIX))
    if bool(wrong.any()):
        row, k = wrong.nonzero()[0].tolist()
        raise LogError(
            f"filter: timing.delay of drive {row} is {float(delay[row, k]):g} s at fix {k}; "
            f"expected {-float(ahead[row]):g} (a sample before the fix) to {OLDEST_FIX:g} s: use a "
            "fix at the end of the sample nearest to its time, delay = that end minus its time"
        )


def _check_deviation(name: str, std: Tensor, told: Tensor) -> None:
    wrong = told & (std <= 0.0)
    if bool(wrong.any()):
        row, k = wrong.nonzero()[0].tolist()
        raise LogError(
            f"filter: fixes.{name} of drive {row} is {float(std[row, k]):g} at fix {k}; expected a "
            "standard deviation above 0 where the fix is valid: give a likely one, or set "
            f"has_{'velocity' if name == 'std_v' else 'position'} to 0"
        )


def _check_radians(where: str, lat: Tensor, lon: Tensor, told: Tensor) -> None:
    for name, angle, limit in (("lat", lat, 0.5 * math.pi), ("lon", lon, 2.0 * math.pi)):
        wrong = told & (angle.abs() > limit)
        if bool(wrong.any()):
            at = wrong.nonzero()[0].tolist()
            fix = f" at fix {at[1]}" if len(at) > 1 else ""
            raise LogError(
                f"filter: {where}.{name} of drive {at[0]} is {float(angle[tuple(at)]):.6g}{fix}; "
                f"expected radians within ±{limit:.4f}: convert degrees with math.radians"
            )
