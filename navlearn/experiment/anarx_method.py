"""ANARX as a method: learned before the outage or elsewhere, run on its own output."""

from collections.abc import Callable

import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx
from navlearn.errors import FitError
from navlearn.experiment.baselines import Believed, FilterRuns, believed, believed_table
from navlearn.experiment.correction import (
    predict,
    regressors_through,
    without_predicted_position_error,
)
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.learned import Learned, adopt, learn
from navlearn.ins_navigator import InsNavigatorRun
from navlearn.logs.drive_log import DriveLog
from navlearn.navigator import Navigator, NavigatorRun, belief_at
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.anarx_spec import AnarxSpec
from navlearn.states import RissSample, Trajectory


class AnarxMethod:
    """The filter, and through the outage its prediction less what the error model predicts.

    The standard deviations are those of the filter: the model was fitted to errors that the
    filter already allows for, so it makes the solution better, not provably surer.
    """

    def __init__(
        self,
        runs: FilterRuns,
        spec: AnarxSpec,
        keep: Callable[[str, Learned], None] | None = None,
    ) -> None:
        """Make a method of a model.

        Args:
            runs: Filter runs, shared with the other methods.
            spec: The model.
            keep: Called with the model's name and each fit, before its solution is returned.
        """
        self.runs, self.spec, self.keep = runs, spec, keep

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the corrected prediction through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        timeline, navigator, run = self.runs.run(log)
        t, recipe = timeline.t[run.first :], self.runs.recipe
        try:
            block, gone = last_fix(run)
            obtain = learn if self.spec.trained is None else adopt
            learned = obtain(
                recipe,
                self.spec,
                navigator,
                run,
                end=gone,
                begin=float(t[0] - run.samples.dt[0]),
                log_name=log.metadata.name,
            )
        except FitError as problem:
            table = believed_table(t, believed(run.history), outage)
            return Solution(table=table, notes={"used": False, "reason": str(problem)})
        if self.keep is not None:
            self.keep(self.spec.name, learned)
        step = max(1, round(recipe.training.step_s / float(run.samples.dt.median())))
        solution = believed(run.history)
        if learned.verdict.use:
            solution = _corrected(learned, self.spec, navigator, run, block, step)
        through = RissSample(*(channel[gone:] for channel in run.samples))
        notes = _notes(learned, self.spec, regressors_through(through, self.spec.inputs, step))
        return Solution(table=believed_table(t, solution, outage), notes=notes)


def last_fix(run: NavigatorRun | InsNavigatorRun) -> tuple[int, int]:
    """Return the block that ends with a run's last fix, and the first sample after it.

    GNSS is gone from there on: a fix just before an outage may be used at the end of an interval
    that ends just after the outage has begun.

    Args:
        run: A run whose fixes end somewhere.

    Raises:
        FitError: There is no fix after the alignment.
    """
    with_fix = torch.nonzero(run.history.fix >= 0)
    if len(with_fix) == 0:
        raise FitError(
            "the filter saw no fix after its alignment, so there is nothing to learn from; start "
            "the outages later"
        )
    block = int(with_fix[-1])
    return block, int(run.history.end[block]) + 1


def _corrected(
    learned: Learned,
    spec: AnarxSpec,
    navigator: Navigator,
    run: NavigatorRun,
    block: int,
    step: int,
) -> Believed:
    """Return a run's solution, corrected from its last fix at the end of ``block`` on."""
    history = run.history
    gone = int(history.end[block]) + 1
    samples = RissSample(*(channel[gone:] for channel in run.samples))
    prediction = predict(learned.fitted, spec, samples, step)
    before = believed(history)
    if spec.acts_on == "azimuth_rate":
        again = navigator.filter_on(belief_at(history, block), samples, prediction[..., 0])
        after = believed(again)
        return Believed(
            _joined(before.trajectory, after.trajectory, gone),
            torch.cat((before.end[: block + 1], after.end + gone)),
            torch.cat((before.covariance[: block + 1], after.covariance)),
        )
    predicted = Trajectory(*(channel[gone:] for channel in history.trajectory))
    better = without_predicted_position_error(predicted, prediction, step)
    return before._replace(trajectory=_joined(before.trajectory, better, gone))


def _joined(whole: Trajectory, later: Trajectory, at: int) -> Trajectory:
    """Return a trajectory whose samples from ``at`` on are another's."""
    return Trajectory(*(torch.cat((old[:at], new)) for old, new in zip(whole, later, strict=True)))


def _notes(learned: Learned, spec: AnarxSpec, u: Tensor) -> dict[str, object]:
    verdict, record = learned.verdict, learned.fitted.record
    model = learned.fitted.model
    notes: dict[str, object] = {
        **gate_notes(verdict, spec.safeguard, used=verdict.use),
        "iterations": record.iterations,
        "train_loss": record.train_loss,
        "valid_loss": learned.trial.valid_loss,
    }
    if isinstance(model, Anarx):
        notes["inputs_outside_training"] = int(model.count_clamped(u).sum())
    return notes
