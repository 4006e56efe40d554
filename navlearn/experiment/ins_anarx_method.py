"""ANARX on the coast of the full-IMU filter, as a method: the sound variant of [Jaradat2017].

Before each outage the filter's past is run over again without fixes from many moments; a network
learns what the error grew by, is judged on the latest of them, and acts only where it helped.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.ins_anarx_diagnostics import Diagnose, sound_diagnostics
from navlearn.experiment.ins_filter_runs import InsFilterRuns
from navlearn.experiment.learned import (
    Learned,
    fit_and_judge,
    pseudo_outage_options,
    split_by_time,
)
from navlearn.experiment.solution_tables import ins_solution_table, with_deviations
from navlearn.filters.ins_belief import map_ins_belief
from navlearn.frames import enu_between
from navlearn.ins_navigator import InsNavigator, InsNavigatorRun, ins_belief_at
from navlearn.learning.fit import fit_anarx
from navlearn.learning.ins_position_windows import (
    INS_OUTPUTS,
    InsOutages,
    coast_inputs,
    emulate_ins_outages,
    ins_training_windows,
    select_ins_outages,
    without_increments,
)
from navlearn.learning.ins_regressors import INS_CHANNELS
from navlearn.learning.options import TrainingOptions
from navlearn.learning.windows import Windows
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.states import ImuSample, InsState


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
            learned, notes, correction = self._learn(
                navigator, run, begin=float(t[0] - run.samples.dt[0]), log_name=log.metadata.name
            )
        except FitError as problem:
            notes = {"used": False, "reason": str(problem)}
        else:
            if self.keep is not None:
                self.keep(self.spec.name, learned)
            if learned.verdict.use:
                path = correction
        table = ins_solution_table(t, path, outage)
        covariance = run.history.belief.covariance[..., :2, :2]
        return Solution(table=with_deviations(table, t[run.history.end], covariance), notes=notes)

    def _learn(
        self, navigator: InsNavigator, run: InsNavigatorRun, *, begin: float, log_name: str
    ) -> tuple[Learned, dict[str, object], InsState]:
        """Return the model, what is told of it, and the path that it makes."""
        spec, training = self.spec, self.runs.recipe.training
        block, gone = last_fix(run)
        outages = emulate_ins_outages(
            navigator.ekf,
            run.samples,
            run.history,
            pseudo_outage_options(self.runs.recipe),
            method=navigator.options.method,
            end=gone,
            begin=begin,
        )
        windows = ins_training_windows(navigator.ekf, outages, spec.inputs)
        source = TrainingSource(
            logs=(log_name,),
            acts_on="position",
            inputs=spec.inputs,
            outputs=INS_OUTPUTS,
            time_step=training.step_s,
            input_units=tuple(INS_CHANNELS[name] for name in spec.inputs),
        )
        trials: list[FittedErrorModel] = []

        def fit(train: Windows, valid: Windows | None, how: TrainingOptions) -> FittedErrorModel:
            network = spec.anarx_options(outputs=len(INS_OUTPUTS))
            trials.append(fit_anarx(train, valid, network, how, source=source, progress=False))
            return trials[-1]

        def judged(trial: FittedErrorModel, index: Tensor) -> GateVerdict:
            return judge_ins(trial, spec, select_ins_outages(outages, index), windows.u[index])

        parts = split_by_time(outages, training.gap_s)
        learned = fit_and_judge(windows, parts, spec.training_options(), fit, judged, spec.name)
        if self.diagnose is not None:
            self.diagnose(spec.name, sound_diagnostics(spec, trials[0], windows, parts))
        u, path = through_the_outage(navigator, run, spec.inputs, block, outages.block, learned)
        return learned, _notes(learned, spec, u), path


def judge_ins(
    fitted: FittedErrorModel, spec: InsAnarxSpec, outages: InsOutages, u: Tensor
) -> GateVerdict:
    """Return whether a model helped on emulated outages that it has not seen.

    Args:
        fitted: The model.
        spec: Its spec, for the gate's margin.
        outages: The emulated outages; there may be none.
        u: Their regressors, shape (N, S, m).
    """
    errors = [torch.zeros(0, dtype=torch.float64)] * 2
    if outages.start_time.numel():
        with torch.no_grad():
            increments: Tensor = fitted.model(u)
        better = without_increments(outages.predicted, increments, outages.block)
        errors = [largest_error(path, outages.reference) for path in (better, outages.predicted)]
    safeguard = spec.safeguard
    found = rolling_origin_gate(*errors, margin=safeguard.gate_margin, fewest=safeguard.gate_fewest)
    return found if safeguard.gate else replace(found, use=True)


def largest_error(path: InsState, reference: InsState) -> Tensor:
    """Return the largest horizontal distance of paths from their references, m, shape (N,).

    Args:
        path: Shape (N, L) each.
        reference: Shape (N, L) each.
    """
    east, north, _ = enu_between(*path[:3], *reference[:3])
    return torch.hypot(east, north).amax(-1)


def through_the_outage(
    navigator: InsNavigator,
    run: InsNavigatorRun,
    inputs: tuple[str, ...],
    block: int,
    step: int,
    learned: Learned,
) -> tuple[Tensor, InsState]:
    """Return the regressors after a run's last fix, and the run's path corrected from there on.

    Args:
        navigator: What made the run.
        run: A run whose fixes end at a block's end.
        inputs: Names of the regressors.
        block: That block.
        step: Samples per step of the model.
        learned: The model.
    """
    history = run.history
    gone = int(history.end[block]) + 1
    samples = ImuSample(*(_whole_steps(channel[gone:], step) for channel in run.samples))
    coast = InsState(*(channel[gone:] for channel in history.trajectory))
    whole = InsState(*(_whole_steps(channel, step) for channel in coast))
    belief = map_ins_belief(ins_belief_at(history, block), lambda channel: channel.unsqueeze(0))
    u = coast_inputs(navigator.ekf, belief, samples, whole, inputs, step)[0]
    with torch.no_grad():
        increments: Tensor = learned.fitted.model(u)
    better = without_increments(coast, increments, step)
    before = (channel[:gone] for channel in history.trajectory)
    return u, InsState(*(torch.cat(pair) for pair in zip(before, better, strict=True)))


def _whole_steps(channel: Tensor, step: int) -> Tensor:
    """Return a channel as a batch of one, its last step filled up by repeating its end."""
    missing = -len(channel) % step
    if missing:
        channel = torch.cat((channel, channel[-1:].expand(missing, *channel.shape[1:])))
    return channel.unsqueeze(0)


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
