"""Has a fix moved as the car did? T_GNSS of [Ghouneem2024] Eq. (24), against the odometer.

As printed a fix is compared with the one before, whatever became of that, as if the car stood:
every fast drive is refused, and so is the first good fix after an outlier. Here the distance
between two fixes is compared with the chord of the way between them, reckoned from odometer and
gyro, and the earlier of the two is the last that this test believed.

Distances are compared, not vectors: a chord needs no azimuth. So the verdicts hang on samples and
fixes alone, are the same in all forms of a filter, and stay right where the filter has run away
and its own prediction refuses good fixes. What a distance does not show, a fix thrown to the side
of a fast car, shows in how far it is from the prediction. What is allowed grows with the way, not
with time: scale factor and gyro drift spoil a chord in proportion to it, and a parked car's fix may
not wander however long it stands.
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
    x: np.ndarray
    y: np.ndarray
    way: np.ndarray
    silent: np.ndarray

    def contradiction(self, a: np.ndarray | int, b: np.ndarray | int) -> np.ndarray:
        """Return by how much the distance between fixes differs from what was reckoned, m."""
        around = (self.lon[b] - self.lon[a] + np.pi) % (2.0 * np.pi) - np.pi
        north = (self.lat[b] - self.lat[a]) * self.per_lat[b]
        moved = np.hypot(around * self.per_lon[b], north)
        reckoned = np.hypot(self.x[b] - self.x[a], self.y[b] - self.y[a])
        return np.asarray(np.abs(moved - reckoned))

    def allowed(self, gate: GateOptions, a: np.ndarray | int, b: np.ndarray | int) -> np.ndarray:
        """Return by how much it may differ, m."""
        limit = gate.motion_limit + gate.motion_growth * (self.way[b] - self.way[a])
        return np.where(self.silent[b] - self.silent[a] > SILENCE, np.inf, limit)


def _antenna(
    row: list[np.ndarray], arm: tuple[float, float], index: np.ndarray, delay: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return the reckoned antenna, the way and the odometer's silence so far, at times of fixes."""
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
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    return x + right * cosine + forward * sine, y - right * sine + forward * cosine, way, silent


def _summed(x: np.ndarray) -> np.ndarray:
    return np.concatenate(([0.0], np.cumsum(x)))


def _refused(gate: GateOptions, seen: _Seen) -> list[float]:
    count = len(seen.lat)
    refused = [0.0] * count
    if gate.motion_reference == "none":
        still = seen._replace(x=0.0 * seen.x, y=0.0 * seen.y, way=0.0 * seen.way)
        return _beyond(gate, still._replace(silent=0.0 * seen.silent), refused)
    beyond = np.array(_beyond(gate, seen, refused))
    if not beyond.any():
        return refused
    # up to the first refusal, the fix before is the last believed
    reference, waited = int(beyond.argmax()) - 1, 0
    for k in range(reference + 1, count):
        wild = not seen.contradiction(reference, k) <= seen.allowed(gate, reference, k)
        if wild and waited < gate.reset_after:
            refused[k], waited = 1.0, waited + 1
        else:
            reference, waited = k, 0
    return refused


def _beyond(gate: GateOptions, seen: _Seen, refused: list[float]) -> list[float]:
    """Return which fixes contradict the ones before them."""
    later = np.arange(1, len(refused))
    wild = ~(seen.contradiction(later - 1, later) <= seen.allowed(gate, later - 1, later))
    return [0.0, *wild.astype(float).tolist()]
