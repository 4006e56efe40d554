"""ANARX on the coast of the full-IMU filter, as a method: the sound variant of [Jaradat2017].

Before each outage the filter's past is run over again without fixes from many moments; a network
learns what the error grew by, is judged on the latest of them, and acts only where it helped.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx
from navlearn.errors import FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.ins_anarx_diagnostics import Diagnose
from navlearn.experiment.ins_anarx_learning import corrected_coast, learn_on_coasts
from navlearn.experiment.ins_filter_runs import InsFilterRuns
from navlearn.experiment.learned import Learned
from navlearn.experiment.solution_tables import ins_solution_table, with_deviations
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.states import InsState


class InsAnarxMethod:
    """The full-IMU filter, through the outage less what the network says of its coast.

    The standard deviations are those of the filter, which allows for these errors already.
    """

    def __init__(
        self,
        runs: InsFilterRuns,
        spec: InsAnarxSpec,
        keep: Callable[[str, Learned], None] | None = None,
        diagnose: Diagnose | None = None,
    ) -> None:
        """Make a method of a model.

        Args:
            runs: Filter runs, shared with the other methods.
            spec: The model.
            keep: Called with the model's name and each fit, before its solution is returned.
            diagnose: Called with the diagnostics of each fit, likewise.
        """
        self.runs, self.spec, self.keep, self.diagnose = runs, spec, keep, diagnose

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the corrected prediction through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        line, navigator, run = self.runs.run(log)
        t, path = line.t[run.first :], run.history.trajectory
        notes: dict[str, object]
        try:
            block, gone = last_fix(run)
            learned, outages = learn_on_coasts(
                self.spec,
                self.runs.recipe,
                navigator,
                run,
                end=gone,
                begin=float(t[0] - run.samples.dt[0]),
                log_name=log.metadata.name,
                diagnose=self.diagnose,
            )
        except FitError as problem:
            notes = {"used": False, "reason": str(problem)}
        else:
            if self.keep is not None:
                self.keep(self.spec.name, learned)
            step = outages.block
            u, better = corrected_coast(navigator, run, self.spec.inputs, block, step, learned)
            notes = _notes(learned, self.spec, u)
            if learned.verdict.use:
                before = (channel[:gone] for channel in path)
                path = InsState(*(torch.cat(two) for two in zip(before, better, strict=True)))
        table = ins_solution_table(t, path, outage)
        covariance = run.history.belief.covariance[..., :2, :2]
        return Solution(table=with_deviations(table, t[run.history.end], covariance), notes=notes)


def _notes(learned: Learned, spec: InsAnarxSpec, u: Tensor) -> dict[str, object]:
    verdict, model = learned.verdict, learned.fitted.model
    notes: dict[str, object] = {
        **gate_notes(verdict, spec.safeguard, used=verdict.use),
        "iterations": learned.fitted.record.iterations,
        "train_loss": learned.fitted.record.train_loss,
        "valid_loss": learned.trial.valid_loss,
    }
    if isinstance(model, Anarx):
        notes["inputs_outside_training"] = int(model.count_clamped(u).sum())
    return notes
