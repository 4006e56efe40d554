"""Fixes and the car between them as the motion test remembers them while driving.

The computation of :mod:`navlearn.fusion.motion_check` for one fix at a time.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.frames import enu_between
from navlearn.fusion.seen_fixes import OLDEST, SHORTEST, SILENCE, TIMES, Carriage
from navlearn.states import GnssFix


class Reckoned(NamedTuple):
    """Where the car is by odometer and gyro, in axes of its start, shape (...) each.

    Attributes:
        time: Since the start, s.
        heading: Clockwise from that at the start, rad.
        x: To the right of that, m.
        y: Ahead, m.
        way: Along its way, m.
        silent: Time without an odometer, s.
    """

    time: Tensor
    heading: Tensor
    x: Tensor
    y: Tensor
    way: Tensor
    silent: Tensor


class SeenFix(NamedTuple):
    """A fix, and where the antenna was reckoned to be at its time, shape (...) each.

    Attributes:
        time: Since the start, s.
        x: To the right of the start's heading, m.
        y: Ahead, m.
        way: Along the car's way, m.
        silent: Time without an odometer, s.
        lat: Latitude, rad.
        lon: Longitude, rad.
        height: Height, m.
        known: 1.0 where there is such a fix.
    """

    time: Tensor
    x: Tensor
    y: Tensor
    way: Tensor
    silent: Tensor
    lat: Tensor
    lon: Tensor
    height: Tensor
    known: Tensor


def carried(car: Reckoned, motion: Carriage) -> Reckoned:
    """Return where the car is reckoned to be after an interval.

    Args:
        car: Before it, shape (...).
        motion: How the car moves in it, shape (...) each.
    """
    turn, ahead = motion.turn_rate * motion.dt, motion.speed * motion.dt
    middle = car.heading + 0.5 * turn
    return Reckoned(
        car.time + motion.dt,
        car.heading + turn,
        car.x + ahead * torch.sin(middle),
        car.y + ahead * torch.cos(middle),
        car.way + motion.speed.abs() * motion.dt,
        car.silent + torch.where(motion.told > 0.5, 0.0, motion.dt),
    )


def seen_fix(car: Reckoned, fix: GnssFix, arm: tuple[float, float]) -> SeenFix:
    """Return a fix with the antenna as reckoned at its time.

    Args:
        car: The car at that time, shape (...).
        fix: The fix, shape (...) each.
        arm: Antenna from the point that is reckoned, right and forward, m.
    """
    (right, forward), sine, cosine = arm, torch.sin(car.heading), torch.cos(car.heading)
    x = car.x + right * cosine + forward * sine
    y = car.y - right * sine + forward * cosine
    place, one = (fix.lat, fix.lon, fix.height), torch.ones_like(fix.lat)
    return SeenFix(car.time, x, y, car.way, car.silent, *place, one)


def contradiction(past: SeenFix, now: SeenFix, *, most: bool) -> Tensor:
    """Return how far a fix is from where it is reckoned from the last one believed.

    Args:
        past: Fixes that were believed, the last one first, shape (..., N).
        now: The fix, shape (...).
        most: Whether the most that it may be is wanted where nothing directs the way, or the least.

    Returns:
        Distance, m, shape (...).
    """
    last = latest(past)
    came, reckoned = between(last, now), (now.x - last.x, now.y - last.y)
    each = SeenFix(*(x.unsqueeze(-1) for x in last))
    before, led = between(past, each), (each.x - past.x, each.y - past.y)
    need = torch.clamp(TIMES * _length(reckoned), min=SHORTEST).unsqueeze(-1)
    fresh = (each.time - past.time <= OLDEST) & (each.silent - past.silent <= SILENCE)
    directs = (past.known > 0.5) & (_length(led) >= need) & fresh
    # the first of them is the latest
    base = directs.to(torch.int64).argmax(-1, keepdim=True)
    e, n, x, y = (torch.gather(v, -1, base).squeeze(-1) for v in (*before, *led))
    cosine, sine = e * x + n * y, n * x - e * y
    size = torch.hypot(cosine, sine)
    directed = directs.any(-1) & (size > 0.0)
    size = torch.where(directed, size, 1.0)
    turned = (
        (cosine * reckoned[0] - sine * reckoned[1]) / size,
        (cosine * reckoned[1] + sine * reckoned[0]) / size,
    )
    off = _length((came[0] - turned[0], came[1] - turned[1]))
    circle = _length(came) + (1.0 if most else -1.0) * _length(reckoned)
    return torch.where(directed, off, circle.abs())


def between(a: SeenFix, b: SeenFix) -> tuple[Tensor, Tensor]:
    """Return how far fixes lie east and north of others.

    Args:
        a: The others, shape (...).
        b: The fixes, shape (...).

    Returns:
        East and north, m, shape (...) each.
    """
    return enu_between(b.lat, b.lon, b.height, a.lat, a.lon, a.height)[:2]


def _length(vector: tuple[Tensor, Tensor]) -> Tensor:
    return torch.hypot(*vector)


def latest(past: SeenFix) -> SeenFix:
    """Return the last fix that was believed, shape (...).

    Args:
        past: Fixes that were believed, the last one first, shape (..., N).
    """
    return SeenFix(*(x[..., 0] for x in past))


def remembered(past: SeenFix, now: SeenFix, new: Tensor, *, anew: Tensor) -> SeenFix:
    """Return past fixes with one more.

    Args:
        past: Fixes, the last one first, shape (..., N).
        now: A fix, shape (...).
        new: Where it is believed, bool, shape (...).
        anew: Where all before it are forgotten, bool, shape (...).
    """
    known = past.known * ~anew.unsqueeze(-1)
    pairs = zip(now, past._replace(known=known), strict=True)
    grown = SeenFix(*(torch.cat((x.unsqueeze(-1), old[..., :-1]), -1) for x, old in pairs))
    return chosen(new, grown, past)


def without_last(past: SeenFix) -> SeenFix:
    """Return past fixes without the last one.

    Args:
        past: Fixes, the last one first, shape (..., N).
    """
    known = torch.nn.functional.pad(past.known[..., 1:], (0, 1))
    return SeenFix(*(torch.roll(x, -1, -1) for x in past))._replace(known=known)


def chosen(condition: Tensor, one: SeenFix, other: SeenFix) -> SeenFix:
    """Return past fixes chosen from two sets.

    Args:
        condition: Whether those of the first, bool, shape (...).
        one: The first, shape (..., N).
        other: The second.
    """
    pairs = zip(one, other, strict=True)
    return SeenFix(*(torch.where(condition.unsqueeze(-1), a, b) for a, b in pairs))
