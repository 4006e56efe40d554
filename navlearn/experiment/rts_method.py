"""Post-processing: the filter before and after an outage, smoothed back through it."""

from typing import ClassVar, Final, NamedTuple

import torch
from torch import Tensor

from navlearn.experiment.baselines import Believed, FilterRuns, believed_table
from navlearn.experiment.drive import timeline_of
from navlearn.filters.belief import Belief
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.smoothing import SmoothedDrive, SmoothingOptions, smooth
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.navigator import Navigator, NavigatorRun, belief_at
from navlearn.outages.known_log import known_log
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.states import FixTiming, GnssFix, RissSample

LEAD: Final = 10.0
"""The stretch that is smoothed begins this long before the outage, s."""


class Stretch(NamedTuple):
    """The part of a drive that an outage's smoothing needs.

    What the filter believes at its first sample holds all that came before, so that smoothing
    the whole drive would tell nothing more of the outage.

    Attributes:
        t: End of every interval, s, shape (T,).
        history: What the filter believed; its indices count from the first interval.
        smoothed: What the smoother makes of it.
    """

    t: Tensor
    history: FilterHistory
    smoothed: SmoothedDrive


class SmoothedFilter:
    """The honest filter, smoothed from fixes on both sides of an outage.

    Attributes:
        sees_after: For how long after the outage's end the method sees fixes and sensors, s.
    """

    sees_after: ClassVar[float] = 120.0

    def __init__(self, runs: FilterRuns, options: SmoothingOptions | None = None) -> None:
        """Make the method.

        Args:
            runs: Filter runs, shared with the other methods.
            options: How drives are smoothed; None means the defaults.
        """
        self.runs, self.options = runs, options or SmoothingOptions()

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the smoothed solution through an outage.

        Args:
            log: The drive up to ``sees_after`` after the outage's end, without fixes inside it.
            outage: The outage.
        """
        _, navigator, run = self.runs.run(known_log(log, outage))
        timeline = timeline_of(log, self.runs.recipe)
        found = smoothed_stretch(timeline, navigator, run, outage.start - LEAD, self.options)
        smoothed, history = found.smoothed, found.history
        covariance = smoothed.belief.covariance[..., :2, :2]
        solution = Believed(smoothed.trajectory, smoothed.end, covariance)
        after = found.t[history.end] >= outage.end
        resets = history.verdict[after][:, Kind.POSITION] == int(Verdict.ACCEPTED_BY_RESET)
        return Solution(
            table=believed_table(found.t, solution, outage),
            notes={
                "fixes_after": int((history.fix[after] >= 0).sum()),
                "gate_reset_after": bool(resets.any()),
                "passes": smoothed.passes,
            },
        )


def smoothed_stretch(
    timeline: RissTimeline,
    navigator: Navigator,
    run: NavigatorRun,
    since: float,
    options: SmoothingOptions | None = None,
) -> Stretch:
    """Filter a drive on from a run that ends earlier, and smooth what lies behind a time.

    Args:
        timeline: The drive; up to ``since`` it is what the navigator ran on.
        navigator: The navigator.
        run: Its run.
        since: Time at which the stretch begins, s.
        options: How it is smoothed; None means the defaults.

    Returns:
        The stretch, from the last update before ``since`` to the end of the timeline.
    """
    begin, belief = _start_of_stretch(timeline, navigator, run, since)
    ekf = navigator.filter
    samples = RissSample(*(channel[begin:] for channel in timeline.samples))
    later = timeline.timing.index >= begin
    fixes = GnssFix(*(channel[later] for channel in timeline.fixes))
    timing = FixTiming(timeline.timing.index[later] - begin, timeline.timing.delay[later])
    with torch.no_grad():
        history = ekf(belief, samples, fixes, timing, method=navigator.options.method)
        smoothed = smooth(ekf, belief, samples, fixes, timing, history, options)
    return Stretch(timeline.t[begin:], history, smoothed)


def _start_of_stretch(
    timeline: RissTimeline, navigator: Navigator, run: NavigatorRun, since: float
) -> tuple[int, Belief]:
    """Return the first interval of a stretch, and the belief before it."""
    ends = run.first + run.history.end
    before = torch.nonzero(timeline.t[ends] <= since).flatten()
    if before.numel() == 0:
        return run.first, navigator.start(run.alignment)
    block = int(before[-1])
    return int(ends[block]) + 1, belief_at(run.history, block)
