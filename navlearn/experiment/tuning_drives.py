"""Which stretches of which drives a recipe's filter may be tuned on, and which judge it.

Of the recipe's own drive only what lies before its first outage is used: no outage that is scored
is ever seen. Other drives (further draws of a simulated one, or logs that are named) are used
whole.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.baselines import filter_options
from navlearn.experiment.drive import open_log, prepare_log, set_clocks, timeline_of
from navlearn.experiment.range_fixes import with_fixes
from navlearn.learning.drive_likelihood import TuningDrive
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.origin import drive_name
from navlearn.outages.store import log_fingerprint
from navlearn.recipe import Recipe
from navlearn.recipe.tuned_spec import TunedOn

LEAST = 120.0
"""Shortest stretch of a drive that is tuned on or judged, s."""


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """A drive, and which part of it may be used.

    Attributes:
        log: The part of the drive that may be used, latencies removed.
        fingerprint: Of the whole drive.
        tuned_until: Time up to which it is tuned on, s; the log's end where all of it is, its
            begin where none of it is.
    """

    log: DriveLog
    fingerprint: str
    tuned_until: float

    @property
    def begin(self) -> float:
        """First time of the log, s."""
        return float(self.log.imu["t"].iloc[0])

    @property
    def end(self) -> float:
        """Last time of the log, s."""
        return float(self.log.imu["t"].iloc[-1])

    @property
    def tuning(self) -> DriveLog | None:
        """The part that is tuned on, if any."""
        if self.tuned_until <= self.begin:
            return None
        return (
            self.log
            if self.tuned_until >= self.end
            else self.log.between(self.begin, self.tuned_until)
        )

    @property
    def judges(self) -> bool:
        """Whether a part of it is held out."""
        return self.tuned_until < self.end

    @property
    def made_from(self) -> TunedOn:
        """What a tuned spec says of it."""
        return TunedOn(
            log=drive_name(self.log.metadata),
            fingerprint=self.fingerprint,
            from_s=self.begin,
            until_s=min(self.tuned_until, self.end),
        )


def own_stretch(recipe: Recipe, holdout: float) -> Stretch:
    """Return the recipe's own drive up to its first outage.

    Args:
        recipe: The recipe.
        holdout: Share of it, at its end, that is held out.

    Raises:
        LogError: The log cannot be used, or too little of it lies before the first outage.
    """
    log = open_log(recipe)
    drive = prepare_log(log, recipe)
    begin = float(drive.log.imu["t"].iloc[0])
    first = min((outage.start for outage in drive.placement.outages), default=math.inf)
    known = drive.log.between(begin, first)
    length = known.duration if len(known.imu) else 0.0
    split = begin + (1.0 - holdout) * length if holdout > 0.0 else math.inf
    shortest = min(length * (1.0 - holdout), length * holdout if holdout > 0.0 else math.inf)
    if shortest < LEAST:
        raise LogError(
            f"{log.metadata.name}: {length:.0f} s lie before its first outage, of which "
            f"{100.0 * holdout:.0f} % are held out; tuning and judging need {LEAST:.0f} s each: "
            "let the first outage come later (outages.warm_up_s), or tune on other drives"
        )
    return Stretch(log=known, fingerprint=log_fingerprint(log), tuned_until=split)


def whole_stretches(recipes: Sequence[Recipe], holdout: float) -> list[Stretch]:
    """Return whole drives, the last of them held out.

    Args:
        recipes: Recipes of the drives.
        holdout: Share of the drives that are held out, rounded up; of a single drive its end.

    Raises:
        ConfigError: A drive is named twice: it would be held out from itself.
        LogError: A log cannot be used.
    """
    logs = [open_log(recipe) for recipe in recipes]
    pairs = zip(logs, recipes, strict=True)
    ready = [set_clocks(with_fixes(log, recipe), recipe, math.inf)[0] for log, recipe in pairs]
    marks = [log_fingerprint(log) for log in logs]
    for k, log in enumerate(logs):
        if marks[k] in marks[:k]:
            raise ConfigError(
                f"{log.metadata.name}: given twice; tuned on it, it would be judged on it, too: "
                "name each drive once"
            )
    if len(ready) == 1:
        begin = float(ready[0].imu["t"].iloc[0])
        split = begin + (1.0 - holdout) * ready[0].duration if holdout > 0.0 else math.inf
        return [Stretch(log=ready[0], fingerprint=marks[0], tuned_until=split)]
    count = min(math.ceil(holdout * len(ready)), len(ready) - 1)
    kept = len(ready) - count
    return [
        Stretch(log=log, fingerprint=mark, tuned_until=math.inf if k < kept else -math.inf)
        for k, (log, mark) in enumerate(zip(ready, marks, strict=True))
    ]


class LaidOut(NamedTuple):
    """A log as what a filter is tuned on.

    Attributes:
        drive: The drive.
        start_time: Begin of its first interval, s.
    """

    drive: TuningDrive
    start_time: float


def laid_out(log: DriveLog, recipe: Recipe) -> LaidOut:
    """Return a log as what a filter is tuned on.

    Args:
        log: The log, latencies removed.
        recipe: Tells rate and dimensions.

    Raises:
        LogError: It has no odometer, gaps that may not be bridged, or no fix.
    """
    if log.fixes.empty:
        raise LogError(f"{log.metadata.name}: no fixes, so that there is nothing to be foretold")
    line, options = timeline_of(log, recipe), filter_options(recipe, log=log)
    drive = TuningDrive(
        log.metadata.name,
        line.samples,
        line.fixes,
        line.timing,
        options.lever_arm,
        options.vertical_velocity,
    )
    return LaidOut(drive, line.start_time)
