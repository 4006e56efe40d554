"""Post-processing: the filter before and after an outage, smoothed back through it."""

from typing import ClassVar

import torch

from navlearn.experiment.baselines import Believed, FilterRuns, believed_table
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.smoothing import SmoothedDrive, SmoothingOptions, smooth
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.navigator import Navigator, NavigatorRun
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.states import FixTiming, GnssFix


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
        timeline, navigator, run = self.runs.run(log)
        found = smoothed_run(timeline, navigator, run, self.options)
        covariance = found.belief.covariance[..., :2, :2]
        solution = Believed(found.trajectory, found.end, covariance)
        t = timeline.t[run.first :]
        after = t[run.history.end] >= outage.end
        resets = run.history.verdict == int(Verdict.ACCEPTED_BY_RESET)
        return Solution(
            table=believed_table(t, solution, outage),
            notes={
                "fixes_after": int((after & (run.history.fix >= 0)).sum()),
                "passes": found.passes,
                "gate_reset_after": bool(resets[after][:, Kind.POSITION].any()),
            },
        )


def smoothed_run(
    timeline: RissTimeline,
    navigator: Navigator,
    run: NavigatorRun,
    options: SmoothingOptions | None = None,
) -> SmoothedDrive:
    """Smooth a navigator's run.

    Args:
        timeline: What it ran on.
        navigator: The navigator.
        run: Its run.
        options: How it is smoothed; None means the defaults.

    Returns:
        The smoothed drive; its indices count from the run's first interval.
    """
    used = timeline.timing.index >= run.first
    with torch.no_grad():
        return smooth(
            navigator.ekf,
            navigator.start(run.alignment),
            run.samples,
            GnssFix(*(channel[used] for channel in timeline.fixes)),
            FixTiming(timeline.timing.index[used] - run.first, timeline.timing.delay[used]),
            run.history,
            options,
        )
