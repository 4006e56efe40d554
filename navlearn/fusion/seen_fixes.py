"""Fixes of a drive beside the way that odometer and gyro reckon between them.

What :mod:`navlearn.fusion.motion_check` judges fixes by.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn import earth
from navlearn.fusion.bounds import OLDEST_FIX
from navlearn.fusion.gate_options import GateOptions
from navlearn.states import GnssFix

SILENCE = 1e-6
"""Time without an odometer between two fixes, s, beyond which nothing tells how far they are
apart."""

SHORTEST = 30.0
"""Shortest chord between believed fixes that tells a direction, m."""

TIMES = 2.0
"""How much longer it is at least than the way that it directs."""

OLDEST = 20.0
"""How much older than the other its first fix may be, s."""


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


def metres_per_radian(fixes: GnssFix) -> tuple[Tensor, Tensor]:
    """Return metres per radian of latitude and longitude."""
    per_lat = earth.meridian_radius(fixes.lat) + fixes.height
    across = earth.prime_vertical_radius(fixes.lat) + fixes.height
    return per_lat, across * torch.cos(fixes.lat)


class Seen(NamedTuple):
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


def reckoned_antenna(
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
