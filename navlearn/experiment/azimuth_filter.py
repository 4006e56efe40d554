"""The feed-forward filter that an azimuth model stands beside, and the car that both steer."""

from dataclasses import replace

import torch

from navlearn.experiment.azimuth_model import AzimuthModel
from navlearn.experiment.baselines import FilterRuns, filter_options
from navlearn.experiment.feed_forward import (
    FeedForward,
    Stretch,
    run_feed_forward,
    stretch_of,
)
from navlearn.experiment.perfect_azimuth import reckoned
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.options import EkfOptions
from navlearn.learning.pseudo_outages import PseudoOutages
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.navigator import NavigatorRun, belief_at
from navlearn.recipe.azimuth_spec import AzimuthSpec
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory


class Beside:
    """The feed-forward filter of a spec on a drive, run over any spans of it.

    Attributes:
        honest: The recipe's own filter on the drive.
        closed: The filter of the spec, with feedback: where it stands is where spans begin.
        options: The same filter's options without feedback.
        ekf: The filter without feedback.
        dt: Length of an interval, s.
        step: Time between rows, s.
    """

    def __init__(
        self,
        runs: FilterRuns,
        spec: AzimuthSpec,
        log: DriveLog,
        timeline: RissTimeline,
        run: NavigatorRun,
    ) -> None:
        """Make the filter ready.

        Args:
            runs: Filter runs, shared with the other methods.
            spec: The model.
            log: The drive.
            timeline: The drive as tensors.
            run: The recipe's own filter on it.
        """
        self.runs, self.spec, self.honest = runs, spec, run
        closed = filter_options(runs.recipe, log=log)
        if spec.filter == "recipe":
            self.closed = run
        else:
            closed = replace(closed, model=spec.filter)
            self.closed = runs.run(log, closed)[2]
        # beside a mechanization that runs free there is nothing to draw sigma points about
        self.options: EkfOptions = replace(closed, feedback="open", unscented=None)
        self.ekf = LooselyCoupledEkf(self.options)
        self.dt = float(run.samples.dt.median())
        self.step = runs.recipe.training.step_s
        later = timeline.timing.index >= run.first
        self.fixes = GnssFix(*(channel[later] for channel in timeline.fixes))
        self.timing = FixTiming(
            timeline.timing.index[later] - run.first, timeline.timing.delay[later]
        )

    def span(self, gone: int, stop: int) -> tuple[int, int, int]:
        """Return a window and what follows it: begin, first interval without GNSS, and end."""
        return gone - round(self.spec.window_s / self.dt), gone, stop

    def origins(self, emulated: PseudoOutages, begin: float) -> list[tuple[int, int]]:
        """Return first interval and end of emulated outages of a run that began then."""
        length = emulated.samples.dt.shape[-1]
        first = [round((start - begin) / self.dt) for start in emulated.start_time.tolist()]
        return [(gone, gone + length) for gone in first]

    def stretch(self, span: tuple[int, int, int]) -> Stretch:
        """Return what the filter needs to run over a span.

        Raises:
            FitError: The drive has no window before.
        """
        return stretch_of(self.closed, self.fixes, self.timing, span)

    def run(self, spans: list[tuple[int, int, int]]) -> list[FeedForward]:
        """Return a run per span, all made at once."""
        return run_feed_forward(self.ekf, [self.stretch(span) for span in spans])


def steer(options: EkfOptions, run: FeedForward, learned: AzimuthModel) -> Trajectory:
    """Return the second mechanization through an outage.

    Args:
        options: The feed-forward filter's options.
        run: Its run over window and outage.
        learned: What its azimuth is less.

    Returns:
        Trajectory from the first interval without GNSS on, shape (L,) each.
    """
    samples = RissSample(*(channel[run.gone :] for channel in run.samples))
    clock = torch.cumsum(run.samples.dt, -1)[run.gone - 1 :]
    azimuth = run.history.trajectory.azimuth[run.gone - 1 :] - learned.at(clock)
    block = int(torch.nonzero(run.history.end < run.gone)[-1])
    belief = belief_at(run.history, block)
    middle = 0.5 * (azimuth[1:] + azimuth[:-1])
    return reckoned(options, belief, samples, middle)._replace(azimuth=azimuth[1:])
