"""Has a fix moved as the car did, asked while driving.

The test of :mod:`navlearn.fusion.motion_check` step by step. A filter's belief knows no earlier
fix, so what the test remembers is carried beside it, and its answer is handed to the filter's
``update`` as ``astray``.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.frames import enu_between
from navlearn.fusion.filter_model import filter_model
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.model import ins_filter_model
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.timeline import arm_from_axle, ins_carriage
from navlearn.fusion.motion_check import MEMORY, OLDEST, SHORTEST, SILENCE, TIMES, Carriage
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.timeline import carriage
from navlearn.states import GnssFix, ImuSample, RissSample


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


class MotionTrack(NamedTuple):
    """What the test carries from sample to sample.

    Attributes:
        car: Where the car is reckoned to be, shape (...).
        past: Fixes that were believed, the last one first, shape (..., N).
        refused: Refusals in a row, shape (...).
    """

    car: Reckoned
    past: SeenFix
    refused: Tensor


class MotionWatch:
    """The motion test of one filter's options; holds no state."""

    def __init__(self, options: EkfOptions | InsEkfOptions) -> None:
        """Make the options ready.

        Args:
            options: Those of the filter.
        """
        self.gate: GateOptions = options.gate
        self.riss = filter_model(options) if isinstance(options, EkfOptions) else None
        if isinstance(options, EkfOptions):
            right, forward, _ = options.lever_arm
            self.arm = (right, forward)
        else:
            self.arm = arm_from_axle(ins_filter_model(options))

    def start(self, like: Tensor) -> MotionTrack:
        """Return what is remembered at first: no fix.

        Args:
            like: Any tensor of the batch shape, dtype and device wanted.
        """
        none = torch.zeros_like(like)
        many = none.unsqueeze(-1).expand(*none.shape, MEMORY + 1)
        car = Reckoned(*(none for _ in Reckoned._fields))
        return MotionTrack(car, SeenFix(*(many for _ in SeenFix._fields)), none)

    def step(self, track: MotionTrack, sample: RissSample | ImuSample) -> MotionTrack:
        """Return what is remembered after a sample.

        Args:
            track: Before it, shape (...).
            sample: The sample, shape (...) each.

        Raises:
            ConfigError: If the sample is not one of the filter's.
        """
        return track._replace(car=_carried(track.car, self._carriage(sample)))

    def judge(
        self,
        track: MotionTrack,
        fix: GnssFix,
        sample: RissSample | ImuSample,
        delay: Tensor | None = None,
    ) -> tuple[MotionTrack, Tensor]:
        """Return what is remembered after a fix, and whether it has moved otherwise than the car.

        Args:
            track: After the sample, shape (...).
            fix: The fix, shape (...) each.
            sample: The sample at whose end it is used, shape (...) each.
            delay: End of the sample minus the fix's time, s, shape (...); None means zero.

        Returns:
            Track, and 1.0 where the fix is refused, shape (...).

        Raises:
            ConfigError: If the sample is not one of the filter's.
        """
        gate, there, past = self.gate, fix.has_position > 0.5, track.past
        back = torch.zeros_like(track.refused) if delay is None else delay
        car = _carried(track.car, self._carriage(sample)._replace(dt=-back))
        now = _seen(car, fix, self.arm)
        wild = there & (past.known[..., 0] > 0.5)
        if gate.motion_reference == "none":
            wild = wild & ~(_length(_moved(_at(past, 0), now)) <= gate.motion_limit)
            past = _remembered(past, now, there, anew=there)
            return track._replace(past=past), wild.to(track.refused)
        earlier = _without_last(past)
        near = self._near(past, now)
        instead = ~near & (earlier.known[..., 0] > 0.5) & self._near(earlier, now, most=True)
        past = _chosen(instead, earlier, past)
        wild = wild & ~near & ~instead
        anew = wild & (track.refused >= gate.reset_after)
        wild = wild & ~anew
        count = torch.where(wild, track.refused + 1.0, torch.where(there, 0.0, track.refused))
        past = _remembered(past, now, there & ~wild, anew=anew)
        return MotionTrack(track.car, past, count), wild.to(track.refused)

    def _near(self, past: SeenFix, now: SeenFix, *, most: bool = False) -> Tensor:
        last = _at(past, 0)
        limit = self.gate.motion_limit + self.gate.motion_growth * (now.way - last.way)
        limit = torch.where(now.silent - last.silent > SILENCE, torch.inf, limit)
        return _contradiction(past, now, most=most) <= limit

    def _carriage(self, sample: RissSample | ImuSample) -> Carriage:
        if isinstance(sample, ImuSample) and self.riss is None:
            return ins_carriage(sample)
        if isinstance(sample, RissSample) and self.riss is not None:
            return carriage(self.riss, sample)
        raise ConfigError(
            f"MotionWatch: found a {type(sample).__name__} for options of another filter; pass the "
            "options of the filter that takes these samples"
        )


def _carried(car: Reckoned, motion: Carriage) -> Reckoned:
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


def _seen(car: Reckoned, fix: GnssFix, arm: tuple[float, float]) -> SeenFix:
    (right, forward), sine, cosine = arm, torch.sin(car.heading), torch.cos(car.heading)
    x = car.x + right * cosine + forward * sine
    y = car.y - right * sine + forward * cosine
    place, one = (fix.lat, fix.lon, fix.height), torch.ones_like(fix.lat)
    return SeenFix(car.time, x, y, car.way, car.silent, *place, one)


def _contradiction(past: SeenFix, now: SeenFix, *, most: bool) -> Tensor:
    """Return how far a fix is from where it is reckoned from the last one believed, m, (...).

    Where nothing directs the way: the least that it may be, or the most.
    """
    last = _at(past, 0)
    moved, reckoned = _moved(last, now), (now.x - last.x, now.y - last.y)
    each = SeenFix(*(x.unsqueeze(-1) for x in last))
    came, led = _moved(past, each), (each.x - past.x, each.y - past.y)
    need = torch.clamp(TIMES * _length(reckoned), min=SHORTEST).unsqueeze(-1)
    fresh = (each.time - past.time <= OLDEST) & (each.silent - past.silent <= SILENCE)
    directs = (past.known > 0.5) & (_length(led) >= need) & fresh
    # the first of them is the latest
    base = directs.to(torch.int64).argmax(-1, keepdim=True)
    e, n, x, y = (torch.gather(v, -1, base).squeeze(-1) for v in (*came, *led))
    cosine, sine = e * x + n * y, n * x - e * y
    size = torch.hypot(cosine, sine)
    directed = directs.any(-1) & (size > 0.0)
    size = torch.where(directed, size, 1.0)
    turned = (
        (cosine * reckoned[0] - sine * reckoned[1]) / size,
        (cosine * reckoned[1] + sine * reckoned[0]) / size,
    )
    off = _length((moved[0] - turned[0], moved[1] - turned[1]))
    circle = _length(moved) + (1.0 if most else -1.0) * _length(reckoned)
    return torch.where(directed, off, circle.abs())


def _moved(a: SeenFix, b: SeenFix) -> tuple[Tensor, Tensor]:
    """Return how far fixes lie east and north of others, m."""
    return enu_between(b.lat, b.lon, b.height, a.lat, a.lon, a.height)[:2]


def _length(vector: tuple[Tensor, Tensor]) -> Tensor:
    return torch.hypot(*vector)


def _at(past: SeenFix, k: int) -> SeenFix:
    return SeenFix(*(x[..., k] for x in past))


def _remembered(past: SeenFix, now: SeenFix, new: Tensor, *, anew: Tensor) -> SeenFix:
    """Return past fixes with one that is believed where ``new``; ``anew`` forgets the others."""
    known = past.known * ~anew.unsqueeze(-1)
    pairs = zip(now, past._replace(known=known), strict=True)
    grown = SeenFix(*(torch.cat((x.unsqueeze(-1), old[..., :-1]), -1) for x, old in pairs))
    return _chosen(new, grown, past)


def _without_last(past: SeenFix) -> SeenFix:
    known = torch.nn.functional.pad(past.known[..., 1:], (0, 1))
    return SeenFix(*(torch.roll(x, -1, -1) for x in past))._replace(known=known)


def _chosen(condition: Tensor, one: SeenFix, other: SeenFix) -> SeenFix:
    pairs = zip(one, other, strict=True)
    return SeenFix(*(torch.where(condition.unsqueeze(-1), a, b) for a, b in pairs))
