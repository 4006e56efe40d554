"""A gyro corrected by what emulated outages taught, as a method.

Before each outage the model is learned from the whole past and judged at origins within it, each
by what lay before. Where that says that it helps, the filter goes through the outage with the
corrected gyro; else the answer is the filter's own, to the last digit.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

from navlearn.error_models.base import TrainingSource
from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.baselines import Believed, FilterRuns, believed, believed_table
from navlearn.experiment.corrected_filter import Stretch, filter_stretches, without_batch
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.gyro_gate import errors_at_origins, past_origins, rate_error, restarted
from navlearn.experiment.learned import Learned
from navlearn.filters.belief import map_belief
from navlearn.fusion.history import FilterHistory
from navlearn.learning.gyro_past import GyroPast, averaged_channels, gyro_past
from navlearn.learning.gyro_rate import GyroFit
from navlearn.learning.gyro_structures import fit_gyro_rate, model_inputs
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.navigator import Navigator, belief_at
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.pseudo_outage_spec import STRUCTURES, PseudoOutageSpec
from navlearn.states import RissSample, Trajectory

EXAMPLE = 600
"""Rows of the last regressors that are kept beside a fitted model."""


class PseudoOutageMethod:
    """The honest filter on a corrected gyro, or as it is where the gate refuses the model."""

    def __init__(
        self,
        runs: FilterRuns,
        spec: PseudoOutageSpec,
        keep: Callable[[str, Learned], None] | None = None,
    ) -> None:
        """Make a method of a model.

        Args:
            runs: Filter runs, shared with the other methods.
            spec: The model.
            keep: Called with the model's name and each fit, before its solution is returned.
        """
        self.runs, self.spec, self.keep = runs, spec, keep
        self.options = spec.options()

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the solution through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        timeline, navigator, run = self.runs.run(log)
        t = timeline.t[run.first :]
        try:
            block, gone = last_fix(run)
            inputs = model_inputs(self.options)
            past = gyro_past(run, navigator.options.filter, inputs, self.options.average, end=gone)
            fit, verdict = self._learn(navigator, past, log.metadata.name)
        except FitError as problem:
            table = believed_table(t, believed(run.history), outage)
            return Solution(table=table, notes={"used": False, "reason": str(problem)})
        if self.keep is not None:
            record = fit.fitted.record
            learned = Learned(
                fitted=fit.fitted, verdict=verdict, example=past.u[-EXAMPLE:], trial=record
            )
            self.keep(self.spec.name, learned)
        solution = believed(run.history)
        if verdict.use:
            again, begin = self._filtered_again(timeline, navigator, past, fit, block)
            solution = _continued(solution, again, begin, gone)
        table = believed_table(t, solution, outage)
        return Solution(table=table, notes=self._notes(past, fit, verdict))

    def _learn(
        self, navigator: Navigator, past: GyroPast, log_name: str
    ) -> tuple[GyroFit, GateVerdict]:
        """Return what the whole past taught, and what it was worth at origins within."""
        spec, run, safeguard = self.spec, past.run, self.spec.safeguard
        dt = float(run.samples.dt.median())
        length = round(spec.judge_s / dt)
        blocks = past_origins(
            run,
            gone=past.end,
            length=length,
            every=round(spec.judge_every_s / dt),
            after=round(spec.judge_after_s / dt),
            least_distance=self.runs.recipe.training.minimum_distance,
        )
        source = TrainingSource(
            logs=(log_name,),
            acts_on="gyro_rate",
            inputs=past.inputs,
            outputs=("gyro_rate_error",),
            time_step=past.block * dt,
        )
        origins = [int(run.history.end[block]) + 1 for block in blocks]
        fits = fit_gyro_rate(past, self.options, [*origins, past.end], source)
        errors = errors_at_origins(navigator, past, blocks, fits[:-1], length)
        verdict = rolling_origin_gate(
            *errors, margin=safeguard.gate_margin, fewest=safeguard.gate_fewest
        )
        # Without terms there is nothing to take off: the filter stays as it is.
        use = (verdict.use or not safeguard.gate) and bool(fits[-1].fitted.options.terms)
        return fits[-1], replace(verdict, use=use)

    def _filtered_again(
        self,
        timeline: RissTimeline,
        navigator: Navigator,
        past: GyroPast,
        fit: GyroFit,
        block: int,
    ) -> tuple[FilterHistory, int]:
        """Return the filter's history with the corrected gyro, and its first sample."""
        run, stop = past.run, len(past.run.samples.dt)
        if self.spec.restart == "regression":
            errors = rate_error(past, fit.fitted, past.end, stop)
            samples = RissSample(*(channel[past.end :] for channel in run.samples))
            belief = restarted(belief_at(run.history, torch.tensor([block])), [fit], navigator)
            single = map_belief(belief, lambda channel: channel[0])
            return navigator.filter_on(single, samples, errors), past.end
        back = past.end - round(self.spec.refilter_s / float(run.samples.dt.median()))
        first = max(int((run.history.end < back).sum()) - 1, 0)
        begin = int(run.history.end[first]) + 1
        errors = rate_error(past, fit.fitted, begin, stop)
        stretch = Stretch(first, past.end, stop)
        history = filter_stretches(
            navigator, run, timeline.fixes, timeline.timing, [stretch], [errors]
        )
        return without_batch(history), begin

    def _notes(self, past: GyroPast, fit: GyroFit, verdict: GateVerdict) -> dict[str, object]:
        model: Any = fit.fitted.model
        safeguard = self.spec.safeguard
        through = RissSample(*(channel[past.end :] for channel in past.run.samples))
        outside = 0
        if len(through.dt):
            u = averaged_channels(through, past.inputs, past.block)
            outside = int(model.count_clamped(u).sum())
        notes = gate_notes(verdict, safeguard, used=verdict.use)
        if not fit.fitted.options.terms:
            notes["reason"] = (
                f"{STRUCTURES[self.spec.structure]}: none was found in this drive so far"
            )
        return {
            **notes,
            "coefficients": model.readable_coefficients(),
            "inputs_outside_training": outside,
            "rows": fit.fitted.record.samples,
            "chi_square": fit.fitted.record.train_loss,
        }


def _continued(before: Believed, again: FilterHistory, begin: int, gone: int) -> Believed:
    """Return a solution whose samples from ``gone`` on are those of the second run."""
    later = believed(again)
    ends = later.end + begin
    new = ends >= gone - 1
    old = before.end < (int(ends[new][0]) if bool(new.any()) else gone)
    return Believed(
        Trajectory(
            *(
                torch.cat((first[:gone], second[gone - begin :]))
                for first, second in zip(before.trajectory, later.trajectory, strict=True)
            )
        ),
        torch.cat((before.end[old], ends[new])),
        torch.cat((before.covariance[old], later.covariance[new])),
    )
