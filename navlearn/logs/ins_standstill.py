"""When does the car stand still? From a full IMU, confirmed by an odometer where there is one.

A car that drives is shaken by the road at 1 to 10 Hz; one that stands is not, whatever its engine
does above 20 Hz. So the signals are averaged over a tenth of a second first: the sensor's white
noise shrinks, the engine disappears, the road stays. Then a generalised likelihood ratio as in
[Skog2010], their acceleration-moving-variance and angular-rate-energy tests in one: variance of
specific force and of angular rate over a trailing window, each in units of a noise floor. The
floors are those of the quietest stretch so far, within physical bounds. That stretch also tells
what the gyro and the norm of specific force read at rest. Nothing after an interval is looked at.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from navlearn.logs.interval_means import FloatArray

BoolArray = npt.NDArray[np.bool_]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class InsStandstillOptions:
    """What counts as standing still.

    Attributes:
        averaging: Time over which signals are averaged first, s.
        window: Trailing time in which they must be quiet, s.
        hold: While a floor is above the least believed, a quiet road may pass for a noisy sensor:
            then the signals must have been quiet this much longer, s.
        quiet_stretch: Length of the stretches among which the quietest tells the floors, s.
        force_floor: Least and largest noise floor of averaged specific force believed, m/s².
        rate_floor: Least and largest noise floor of averaged angular rate believed, rad/s.
        factor: A still car's signals spread up to this many floors (root mean square of both).
        jump: The newest averaged value may be this many floors from its window's mean.
        max_rate: Largest mean angular rate of a still car while its gyro bias is unknown, rad/s.
        max_rate_change: Largest difference of mean angular rate from that of the quietest
            stretch, rad/s.
        max_force_change: Largest difference of the norm of mean specific force from that of the
            quietest stretch, m/s².
        max_speed: An odometer speed up to this says "still", m/s.
        settle: The odometer must have said so for this long, s.
        trust: With an odometer that says "still", ``factor`` and ``jump`` are this much larger.
    """

    averaging: float = 0.1
    window: float = 1.0
    hold: float = 1.0
    quiet_stretch: float = 3.0
    force_floor: Range = (0.02, 0.05)
    rate_floor: Range = (0.0008, 0.003)
    factor: float = 2.0
    jump: float = 4.0
    max_rate: float = 0.035
    max_rate_change: float = 0.006
    max_force_change: float = 0.15
    max_speed: float = 0.05
    settle: float = 1.0
    trust: float = 3.0


class _Windows(NamedTuple):
    """Averaged signals over trailing windows, first window complete at its own length."""

    mean: FloatArray
    variance: FloatArray
    newest: FloatArray


def standstill_intervals(
    dt: float,
    omega_ib_b: FloatArray,
    f_b: FloatArray,
    *,
    measured: BoolArray | None = None,
    speed: FloatArray | None = None,
    has_speed: BoolArray | None = None,
    options: InsStandstillOptions | None = None,
) -> BoolArray:
    """Return for each interval whether the car stands still through it.

    Args:
        dt: Length of the uniform intervals, s.
        omega_ib_b: Mean angular rate, rad/s, shape (T, 3).
        f_b: Mean specific force, m/s², shape (T, 3).
        measured: Where the IMU told anything; bridged gaps are neither quiet nor still, shape (T,).
        speed: Mean odometer speed, m/s, shape (T,), or None without odometer.
        has_speed: Where the odometer told it, shape (T,).
        options: Limits; the defaults suit cars with MEMS and better sensors.

    Returns:
        True where the car stands still, shape (T,).
    """
    limits = options or InsStandstillOptions()
    known = np.ones(len(f_b), dtype=np.bool_) if measured is None else measured
    if len(f_b) == 0:
        return known
    trusted, vetoed = _odometer(dt, len(f_b), speed, has_speed, limits)
    widen = np.where(trusted, limits.trust, 1.0)
    force, force_floor, force_rest = _quietest(dt, f_b, known, limits.force_floor, limits)
    rate, rate_floor, rate_rest = _quietest(dt, omega_ib_b, known, limits.rate_floor, limits)
    ratio = 0.5 * (force.variance / force_floor**2 + rate.variance / rate_floor**2)
    still = ratio <= (limits.factor * widen) ** 2
    for windows, floor in ((force, force_floor), (rate, rate_floor)):
        leap = np.abs(windows.newest - windows.mean).max(1)
        still &= leap <= limits.jump * widen * floor
    norm = np.linalg.norm(force.mean, axis=1) - np.linalg.norm(force_rest, axis=1)
    still &= ~(np.abs(norm) > limits.max_force_change)
    still &= ~(np.linalg.norm(rate.mean - rate_rest, axis=1) > limits.max_rate_change)
    still &= np.linalg.norm(rate.mean, axis=1) <= limits.max_rate
    still &= ~vetoed & _all_of_last(known, _count(dt, limits.window, 5))
    sure = (force_floor <= limits.force_floor[0]) & (rate_floor <= limits.rate_floor[0])
    return still & (sure | trusted | _all_of_last(still, _count(dt, limits.hold, 1)))


def _quietest(
    dt: float, signal: FloatArray, known: BoolArray, bounds: Range, limits: InsStandstillOptions
) -> tuple[_Windows, FloatArray, FloatArray]:
    """Return windows of a signal, its noise floor so far, and its mean in the quietest stretch."""
    size = _count(dt, limits.averaging, 1)
    averaged = _sliding_mean(signal, size)
    windows = _windows(averaged, _count(dt, limits.window, 5))
    length = _count(dt, limits.quiet_stretch, 15)
    stretch = _windows(averaged, length)
    complete = _all_of_last(known, length + size)
    spread = np.where(complete, stretch.variance, np.inf)
    least = np.minimum.accumulate(spread)
    floor = np.clip(np.sqrt(np.where(np.isfinite(least), least, 0.0)), *bounds)
    at = np.maximum.accumulate(np.where(spread <= least, np.arange(len(signal)), 0))
    rest = np.where(np.isfinite(least)[:, None], stretch.mean[at], np.nan)
    return windows, floor, rest


def _windows(signal: FloatArray, length: int) -> _Windows:
    mean = _sliding_mean(signal, length)
    # Differences from the first sample, not from the mean of all: nothing later may take part.
    centred = signal - signal[0]
    squares = _sliding_mean(centred**2, length) - _sliding_mean(centred, length) ** 2
    return _Windows(mean, np.maximum(squares, 0.0).mean(1), signal)


def _sliding_mean(signal: FloatArray, length: int) -> FloatArray:
    """Return means of the last ``length`` values, of fewer at the beginning, shape (T, 3)."""
    total = np.concatenate((np.zeros((1, signal.shape[1])), np.cumsum(signal - signal[0], axis=0)))
    last = np.arange(1, len(signal) + 1)
    first = np.maximum(last - length, 0)
    mean: FloatArray = (total[last] - total[first]) / (last - first)[:, None] + signal[0]
    return mean


def _all_of_last(flags: BoolArray, length: int) -> BoolArray:
    total = np.concatenate(([0], np.cumsum(flags)))
    last = np.arange(1, flags.size + 1)
    every: BoolArray = (last >= length) & (
        total[last] - total[np.maximum(last - length, 0)] == length
    )
    return every


def _odometer(
    dt: float,
    count: int,
    speed: FloatArray | None,
    has_speed: BoolArray | None,
    limits: InsStandstillOptions,
) -> tuple[BoolArray, BoolArray]:
    """Return where an odometer says that the car stands, and where it says that it moves."""
    if speed is None or has_speed is None:
        none = np.zeros(count, dtype=np.bool_)
        return none, none
    zero = has_speed & (np.abs(speed) <= limits.max_speed)
    moves = has_speed & ~zero
    settled = _all_of_last(~moves, min(_count(dt, limits.settle, 1), count))
    return zero & settled, moves | ~settled


def _count(dt: float, length: float, least: int) -> int:
    return max(round(length / dt), least)
