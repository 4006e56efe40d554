"""Has a fix moved as the car did, asked while driving.

The test of :mod:`navlearn.fusion.motion_check` step by step. A filter's belief knows no earlier
fix, so what the test remembers is carried beside it, and its answer is handed to the filter's
``update`` as ``astray``.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.fusion.astray_fixes import carriage
from navlearn.fusion.filter_model import filter_model
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.model import ins_filter_model
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.timeline import arm_from_axle, ins_carriage
from navlearn.fusion.motion_check import MEMORY
from navlearn.fusion.motion_track import (
    Reckoned,
    SeenFix,
    between,
    carried,
    chosen,
    contradiction,
    latest,
    remembered,
    seen_fix,
    without_last,
)
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.seen_fixes import SILENCE, Carriage
from navlearn.states import GnssFix, ImuSample, RissSample


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
        return track._replace(car=carried(track.car, self._carriage(sample)))

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
        car = carried(track.car, self._carriage(sample)._replace(dt=-back))
        now = seen_fix(car, fix, self.arm)
        wild = there & (past.known[..., 0] > 0.5)
        if gate.motion_reference == "none":
            wild = wild & ~(torch.hypot(*between(latest(past), now)) <= gate.motion_limit)
            past = remembered(past, now, there, anew=there)
            return track._replace(past=past), wild.to(track.refused)
        earlier = without_last(past)
        near = self._near(past, now)
        instead = (
            there & ~near & (earlier.known[..., 0] > 0.5) & self._near(earlier, now, most=True)
        )
        past = chosen(instead, earlier, past)
        wild = wild & ~near & ~instead
        anew = wild & (track.refused >= gate.reset_after)
        wild = wild & ~anew
        count = torch.where(wild, track.refused + 1.0, torch.where(there, 0.0, track.refused))
        past = remembered(past, now, there & ~wild, anew=anew)
        return MotionTrack(track.car, past, count), wild.to(track.refused)

    def _near(self, past: SeenFix, now: SeenFix, *, most: bool = False) -> Tensor:
        last = latest(past)
        limit = self.gate.motion_limit + self.gate.motion_growth * (now.way - last.way)
        limit = torch.where(now.silent - last.silent > SILENCE, torch.inf, limit)
        return contradiction(past, now, most=most) <= limit

    def _carriage(self, sample: RissSample | ImuSample) -> Carriage:
        if isinstance(sample, ImuSample) and self.riss is None:
            return ins_carriage(sample)
        if isinstance(sample, RissSample) and self.riss is not None:
            return carriage(self.riss, sample)
        raise ConfigError(
            f"MotionWatch: found a {type(sample).__name__} for options of another filter; pass the "
            "options of the filter that takes these samples"
        )
