"""Runs of the full-IMU filter over known logs, made once and shared by the methods."""

import math
from dataclasses import replace
from typing import Any

import torch

from navlearn import attitude
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.ins_navigator import InsNavigator, InsNavigatorOptions, InsNavigatorRun
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_timeline import ImuTimeline, ImuTimelineOptions, imu_timeline
from navlearn.mechanization.ins_alignment_result import InsAlignment, stated_alignment
from navlearn.outages.store import log_fingerprint
from navlearn.recipe import Recipe
from navlearn.states import InsState

UNAIDED: dict[str, Any] = {
    "odometer": False,
    "nonholonomic": False,
    "zero_velocity": False,
    "zero_angular_rate": False,
}
"""GNSS alone."""

_DAHMANE2022: dict[str, Any] = {**UNAIDED, "model": "dahmane2022", "states": 9}

VARIANTS: dict[str, dict[str, Any]] = {
    "ins_ekf": {},
    "ins_ukf": {},
    "ins_ekf+tuned": {},
    "ins_ukf+tuned": {},
    "ins_ekf_open_loop": {"feedback": "open"},
    "ins_ekf_plain": UNAIDED,
    "ins_ekf_dahmane2022": _DAHMANE2022,
    "ins_ekf_dahmane2022_open": {**_DAHMANE2022, "feedback": "open"},
}
"""What each method changes of the recipe's filter, beside its ingredients."""


KNOWN_TO: dict[str, float] = {
    "tilt": math.radians(0.5),
    "azimuth": math.radians(0.5),
    "position": 1.0,
    "velocity": 0.1,
}
"""Standard deviations of a stated start: rad, rad, m, m/s."""


def ins_filter_options(
    recipe: Recipe, method: str = "ins_ekf", log: DriveLog | None = None
) -> InsEkfOptions:
    """Return the options of a method's full-IMU filter: the recipe's, for every method alike.

    Args:
        recipe: The recipe.
        method: A name of :data:`VARIANTS`.
        log: Tells the lever arm of the antenna, and whether fixes have a vertical velocity, where
            the recipe does not.
    """
    options = recipe.ins_ekf_options(method)
    if log is not None and "lever_arm" not in recipe.ins_filter:
        options = replace(options, lever_arm=log.metadata.lever_arm)
    if log is not None and "vertical_velocity" not in recipe.ins_filter:
        told = "v_u" in log.fixes and bool(log.fixes["v_u"].notna().any())
        options = replace(options, vertical_velocity=told)
    return replace(options, **VARIANTS[method])


def imu_timeline_of(log: DriveLog, recipe: Recipe) -> ImuTimeline:
    """Return a log as the tensors that full-IMU filters take.

    Args:
        log: The log, latencies removed.
        recipe: Its ``mechanization`` section tells the rate.
    """
    section = recipe.mechanization
    options = ImuTimelineOptions(max_imu_gap=section.imu_max_gap_s)
    return imu_timeline(log, rate_hz=section.imu_rate_hz, options=options)


def stated_start(log: DriveLog) -> InsAlignment | None:
    """Return the alignment of a log that states its start, or None.

    Args:
        log: The log.
    """
    start = log.metadata.start
    if start is None:
        return None

    def value(number: float) -> torch.Tensor:
        return torch.tensor(number, dtype=torch.float64)

    angles = (value(start.azimuth), value(start.pitch), value(start.roll))
    state = InsState(
        value(start.lat),
        value(start.lon),
        value(start.height),
        torch.tensor([start.v_e, start.v_n, start.v_u], dtype=torch.float64),
        attitude.quaternion_from_angles(*angles),
    )
    return stated_alignment(state, **KNOWN_TO)


class InsFilterRuns:
    """Runs of the full-IMU filter, by the content of their log and their options."""

    def __init__(self, recipe: Recipe) -> None:
        """Make an empty store of runs.

        Args:
            recipe: The recipe.
        """
        self.recipe = recipe
        self._made: dict[tuple[str, str], tuple[ImuTimeline, InsNavigator, InsNavigatorRun]] = {}

    def run(
        self, log: DriveLog, options: InsEkfOptions | None = None
    ) -> tuple[ImuTimeline, InsNavigator, InsNavigatorRun]:
        """Return timeline, navigator and run of a log.

        Args:
            log: The drive up to an outage's end, without fixes from its start.
            options: Which filter; None is the recipe's honest one.
        """
        chosen = ins_filter_options(self.recipe, log=log) if options is None else options
        # Raw ranges are nothing to this filter, whichever satellites stay.
        key = (repr(chosen), log_fingerprint(replace(log, ranges=None)))
        if key not in self._made:
            navigator = InsNavigator(InsNavigatorOptions(filter=chosen))
            line = imu_timeline_of(log, self.recipe)
            start = stated_start(log)
            run = navigator.run(
                line.samples, line.fixes, line.timing, alignment=start, bridged=line.bridged
            )
            self._made[key] = (line, navigator, run)
        return self._made[key]
