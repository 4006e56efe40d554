"""Has a fix moved as the car did? T_GNSS of [Ghouneem2024] Eq. (24), against the odometer.

As printed a fix is compared with the one before, whatever became of that, as if the car stood:
every fast drive is refused, and so is the first good fix after an outlier. Here the way between two
fixes is compared with that reckoned from odometer and gyro, and the earlier of the two is the last
that this test believed. Should that one have been wrong, the fixes after it would be refused in its
stead: one that surely agrees with the fix believed before it is believed, too, and the last
forgotten.

Odometer and gyro tell the shape of a way, not where it leads. That is taken from fixes believed
earlier: from one far enough back that the chord to the reference tells a direction, and near enough
that the gyro's drift does not matter. Where there is none, two distances are compared, which shows
less: a fix may then lie anywhere on a circle. The azimuth of the filter would tell the direction,
too, but so the verdicts hang on samples and fixes alone, are the same in all forms of a filter, and
stay right where the filter has run away and its own prediction refuses good fixes.

What is allowed grows with the way, not with time: scale factor and gyro drift spoil a reckoned way
in proportion to it, and a parked car's fix may not wander however long it stands.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn import earth
from navlearn.fusion.bounds import OLDEST_FIX
from navlearn.fusion.gate_options import GateOptions
from navlearn.states import FixTiming, GnssFix

SILENCE = 1e-6
"""Time without an odometer between two fixes, s, beyond which nothing tells how far they are
apart."""

SHORTEST = 30.0
"""Shortest chord between believed fixes that tells a direction, m."""

TIMES = 2.0
"""How much longer it is at least than the way that it directs."""

OLDEST = 20.0
"""How much older than the other its first fix may be, s."""

MEMORY = 32
"""How many believed fixes before the last are looked at for it."""


class Carriage(NamedTuple):
    """How samples carry the antenna, shape (..., T) each.

    Attributes:
        dt: Length of the interval, s.
        turn_rate: Rate of turn, rad/s, clockwise positive.
        speed: Horizontal speed of the car by the odometer, m/s.
        told: 1.0 where there is one.
    """

    dt: Tensor
    turn_rate: Tensor
    speed: Tensor
    told: Tensor


@torch.no_grad()
def astray(
    gate: GateOptions,
    arm: tuple[float, float],
    carriage: Carriage,
    fixes: GnssFix,
    timing: FixTiming,
) -> Tensor:
    """Return which fixes have moved otherwise than the car.

    The first fix is believed, and so is one after ``reset_after`` refusals in a row. Without an
    odometer between them two fixes are not compared.

    Args:
        gate: Limits.
        arm: Antenna from the point whose speed the odometer tells, right and forward, m.
        carriage: The car's motion, shape (B, T) each.
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.

    Returns:
        1.0 where a fix is refused, shape (B, M).
    """
    found = torch.zeros_like(fixes.lat)
    if not gate.tests_motion or timing.index.shape[-1] == 0:
        return found
    radii = _metres(fixes)
    there = (timing.index >= 0) & (fixes.has_position > 0.5)
    for b in range(len(found)):
        use = there[b].cpu().numpy()
        if not use.any():
            continue
        row = [channel[b].cpu().numpy() for channel in carriage]
        index, delay = (x[b].cpu().numpy()[use] for x in timing)
        places = [x[b].cpu().numpy()[use] for x in (fixes.lat, fixes.lon, *radii)]
        seen = _Seen(*places, *_antenna(row, arm, index, delay))
        refused = _refused(gate, seen)
        found[b, torch.from_numpy(np.flatnonzero(use)).to(found.device)] = found.new_tensor(refused)
    return found


def _metres(fixes: GnssFix) -> tuple[Tensor, Tensor]:
    """Return metres per radian of latitude and longitude."""
    per_lat = earth.meridian_radius(fixes.lat) + fixes.height
    across = earth.prime_vertical_radius(fixes.lat) + fixes.height
    return per_lat, across * torch.cos(fixes.lat)


class _Seen(NamedTuple):
    """Fixes of one drive, and the antenna reckoned at their times in axes of the drive's start."""

    lat: np.ndarray
    lon: np.ndarray
    per_lat: np.ndarray
    per_lon: np.ndarray
    at: np.ndarray
    reckoned: np.ndarray
    way: np.ndarray
    silent: np.ndarray

    def moved(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return how fixes have moved, m, east the real part and north the imaginary."""
        around = (self.lon[b] - self.lon[a] + np.pi) % (2.0 * np.pi) - np.pi
        return np.asarray(
            around * self.per_lon[b] + 1j * (self.lat[b] - self.lat[a]) * self.per_lat[b]
        )

    def contradiction(
        self, a: np.ndarray, b: np.ndarray, base: np.ndarray, *, most: bool = False
    ) -> np.ndarray:
        """Return how far fixes ``b`` are from where they were reckoned from fixes ``a``, m.

        ``base`` are the fixes that direct the way, −1 for none: then it is the least that it may
        be, or the most.
        """
        moved, reckoned = self.moved(a, b), self.reckoned[b] - self.reckoned[a]
        first = np.where(base >= 0, base, a)
        turned = self.moved(first, a) * np.conj(self.reckoned[a] - self.reckoned[first])
        size = np.abs(turned)
        directed = (base >= 0) & (size > 0.0)
        turn = np.where(directed, turned / np.where(directed, size, 1.0), 0.0)
        circle = np.abs(np.abs(moved) + (1.0 if most else -1.0) * np.abs(reckoned))
        return np.asarray(np.where(directed, np.abs(moved - turn * reckoned), circle))

    def directs(self, j: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return whether the way from ``j`` to ``a`` tells where that from ``a`` to ``b`` leads."""
        far = np.abs(self.reckoned[a] - self.reckoned[j])
        need = np.maximum(SHORTEST, TIMES * np.abs(self.reckoned[b] - self.reckoned[a]))
        young = self.at[a] - self.at[j] <= OLDEST
        return np.asarray((far >= need) & young & (self.silent[a] - self.silent[j] <= SILENCE))

    def allowed(self, gate: GateOptions, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return how far they may be, m."""
        limit = gate.motion_limit + gate.motion_growth * (self.way[b] - self.way[a])
        return np.where(self.silent[b] - self.silent[a] > SILENCE, np.inf, limit)


def _antenna(
    row: list[np.ndarray], arm: tuple[float, float], index: np.ndarray, delay: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return times of fixes, and then the reckoned antenna, the way and the odometer's silence."""
    dt, rate, speed, told = row
    # a fix may be older than the first sample: the car came as it goes on
    before = (OLDEST_FIX, 0.0, speed[0], told[0])
    dt, rate, speed, told = (
        np.concatenate(([first], x)) for first, x in zip(before, row, strict=True)
    )
    heading = _summed(rate * dt)
    middle = 0.5 * (heading[1:] + heading[:-1])
    time = _summed(dt)
    channels = (
        heading,
        _summed(speed * dt * np.sin(middle)),
        _summed(speed * dt * np.cos(middle)),
        _summed(np.abs(speed) * dt),
        _summed(dt * (told <= 0.5)),
    )
    at = time[index + 2] - delay
    azimuth, x, y, way, silent = (np.interp(at, time, channel) for channel in channels)
    right, forward = arm
    antenna = x + 1j * y + (right + 1j * forward) * np.exp(-1j * azimuth)
    return at, antenna, way, silent


def _summed(x: np.ndarray) -> np.ndarray:
    return np.concatenate(([0.0], np.cumsum(x)))


def _refused(gate: GateOptions, seen: _Seen) -> list[float]:
    count = len(seen.lat)
    later = np.arange(1, count)
    if gate.motion_reference == "none":
        moved = np.abs(seen.moved(later - 1, later))
        return [0.0, *(~(moved <= gate.motion_limit)).astype(float).tolist()]
    base = _latest_base(seen, later)
    wild = ~(seen.contradiction(later - 1, later, base) <= seen.allowed(gate, later - 1, later))
    if not wild.any():
        return [0.0] * count
    return _in_turn(gate, seen, wild.tolist())


def _latest_base(seen: _Seen, later: np.ndarray) -> np.ndarray:
    """Return which fix directs the way from each fix to the next, −1 for none."""
    base = np.full(len(later), -1)
    for lag in range(1, MEMORY + 1):
        first = later - 1 - lag
        here = (first >= 0) & (base < 0)
        here &= seen.directs(np.maximum(first, 0), later - 1, later)
        base[here] = first[here]
    return base


def _in_turn(gate: GateOptions, seen: _Seen, wild: list[bool]) -> list[float]:
    """Return which fixes are refused, one after another.

    ``wild`` tells which contradict the one before, if all before them are believed: that holds
    again where those that may direct the way have been believed without a gap.
    """
    refused = [0.0] * len(seen.lat)
    past, waited, since = [0], 0, 0
    for k in range(1, len(seen.lat)):
        unbroken = since == 0 or k - since > MEMORY + 1
        if unbroken and not wild[k - 1]:
            past.append(k)
            continue
        agreeing = next(
            (n for n in (1, 2) if n <= len(past) and _agrees(gate, seen, past, n, k)), 0
        )
        if agreeing == 1:
            past.append(k)
            waited = 0
        elif agreeing == 2:
            # the fix before the last agrees and the last does not: that one was wrong
            past[-1] = k
            waited, since = 0, k
        elif waited < gate.reset_after:
            refused[k], waited, since = 1.0, waited + 1, k + 1
        else:
            past, waited, since = [k], 0, k
    return refused


def _agrees(gate: GateOptions, seen: _Seen, past: list[int], back: int, k: int) -> bool:
    """Return whether a fix agrees with one believed before it, ``back`` from the end."""
    a, b = np.array(past[-back]), np.array(k)
    tried = np.array(past[-back - 1 : -back - 1 - MEMORY : -1], dtype=int)
    able = tried[seen.directs(tried, a, b)] if len(tried) > 0 else tried
    base = able[0] if len(able) > 0 else np.array(-1)
    off = seen.contradiction(a, b, base, most=back > 1)
    return bool(off <= seen.allowed(gate, a, b))
