"""The papers' azimuth models as methods: trained beside a feed-forward filter, online.

Source: [Shen2010] §3.2 and Eq. (13), [Iqbal2020, VIII]. Through the outage the feed-forward
filter goes on without fixes, the model predicts ΔA from what that filter predicts, and a second
mechanization runs on odometer and A_mec − δA_KF − ΔA from where the last fix left the filter.
"""

import math
from collections.abc import Callable, Sequence
from itertools import islice
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.fos import FosModel
from navlearn.error_models.safeguard import GateVerdict
from navlearn.errors import FilterDivergedError, FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.azimuth_filter import Beside, steer
from navlearn.experiment.azimuth_gate import recent_outages, verdict_on
from navlearn.experiment.azimuth_model import AzimuthModel, fit_azimuth
from navlearn.experiment.baselines import (
    Believed,
    FilterRuns,
    believed,
    believed_table,
)
from navlearn.experiment.feed_forward import FeedForward, Stretch, run_feed_forward
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.learned import Learned
from navlearn.learning.pseudo_outages import PseudoOutages
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.azimuth_spec import AzimuthSpec
from navlearn.states import Trajectory


class _Fallback(NamedTuple):
    """The honest filter through an outage."""

    t: Tensor
    solution: Believed
    outage: Outage


class _Prepared(NamedTuple):
    """An outage for which the feed-forward filter is to run."""

    fallback: _Fallback
    log_name: str
    beside: Beside
    emulated: PseudoOutages | None
    stretches: list[Stretch]


class AzimuthMethod:
    """A second mechanization through the outage; where it is refused, the honest filter.

    The standard deviations are those of the feed-forward filter.
    """

    def __init__(
        self,
        runs: FilterRuns,
        spec: AzimuthSpec,
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
        """Return the steered mechanization through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.

        Raises:
            FilterDivergedError: The paper's filter diverged, and no gate stands before it.
        """
        return self.predict_many([log], [outage])[0]

    def predict_many(self, logs: Sequence[DriveLog], outages: Sequence[Outage]) -> list[Solution]:
        """Return the solutions of several outages, the same as one by one.

        The feed-forward filter runs over the windows of all of them at once.

        Args:
            logs: A log per outage, as for :meth:`predict`.
            outages: The outages.

        Raises:
            FilterDivergedError: The filter diverged in one of several, or no gate stands before.
        """
        asked = [self._prepared(log, outage) for log, outage in zip(logs, outages, strict=True)]
        ready = [one for one in asked if isinstance(one, _Prepared)]
        try:
            stretches = [stretch for one in ready for stretch in one.stretches]
            made = iter(run_feed_forward(ready[0].beside.ekf, stretches) if ready else [])
        except FilterDivergedError as problem:
            if len(asked) > 1:
                raise
            return [self._refused(ready[0].fallback, problem)]
        return [
            self._finished(one, list(islice(made, len(one.stretches))))
            if isinstance(one, _Prepared)
            else one
            for one in asked
        ]

    def _prepared(self, log: DriveLog, outage: Outage) -> "_Prepared | Solution":
        """Return what the feed-forward filter is to run over, or the honest filter's solution."""
        timeline, navigator, run = self.runs.run(log)
        t = timeline.t[run.first :]
        fallback = _Fallback(t, believed(run.history), outage)
        try:
            _, gone = last_fix(run)
            beside = Beside(self.runs, self.spec, log, timeline, run)
            begin = float(t[0] - run.samples.dt[0])
            emulated = recent_outages(beside, navigator, gone, begin)
            origins = [] if emulated is None else beside.origins(emulated, begin)
            spans = [(gone, len(run.samples.dt)), *origins]
            stretches = [beside.stretch(beside.span(*one)) for one in spans]
        except (FitError, FilterDivergedError) as problem:
            return self._refused(fallback, problem)
        return _Prepared(fallback, log.metadata.name, beside, emulated, stretches)

    def _refused(self, fallback: "_Fallback", problem: Exception) -> Solution:
        """Return the honest filter's solution; a paper's filter that diverges has none."""
        if isinstance(problem, FilterDivergedError) and not self.spec.safeguard.gate:
            raise problem
        notes = {"used": False, "fitted": False, "reason": str(problem)}
        return Solution(table=believed_table(*fallback), notes=notes)

    def _finished(self, ready: "_Prepared", runs: list[FeedForward]) -> Solution:
        """Return the solution of an outage from the feed-forward filter's runs."""
        beside, (path, *replays) = ready.beside, runs
        try:
            learned = fit_azimuth(
                self.spec,
                beside.ekf.model,
                path,
                step=beside.step,
                log_name=ready.log_name,
                begin=float(ready.fallback.t[0]) + (path.begin - 1) * beside.dt,
            )
            verdict = verdict_on(beside, ready.emulated, replays)
        except (FitError, FilterDivergedError) as problem:
            return self._refused(ready.fallback, problem)
        if self.keep is not None:
            example, record = learned.inputs[learned.origin :], learned.fitted.record
            self.keep(
                self.spec.name,
                Learned(fitted=learned.fitted, verdict=verdict, example=example, trial=record),
            )
        solution = ready.fallback.solution
        if verdict.use:
            solution = _joined(solution, path, steer(beside.options, path, learned))
        notes = _notes(self.spec, learned, verdict)
        table = believed_table(ready.fallback.t, solution, ready.fallback.outage)
        return Solution(table=table, notes=notes)


def _joined(plain: Believed, run: FeedForward, path: Trajectory) -> Believed:
    """Return the honest solution up to the last fix, and the steered one from there on."""
    gone = run.begin + run.gone
    whole = Trajectory(
        *(torch.cat((old[:gone], new)) for old, new in zip(plain.trajectory, path, strict=True))
    )
    before, after = plain.end < gone, run.history.end >= run.gone
    spread = run.history.belief.covariance[after, :2, :2].detach()
    return Believed(
        whole,
        torch.cat((plain.end[before], run.history.end[after] + run.begin)),
        torch.cat((plain.covariance[before], spread)),
    )


def _notes(spec: AzimuthSpec, learned: AzimuthModel, verdict: GateVerdict) -> dict[str, object]:
    judged = gate_notes(verdict, spec.safeguard, used=verdict.use)
    if not spec.safeguard.gate:
        judged = {
            "used": verdict.use,
            "reason": "no gate: the spec switches it off, as the paper has none",
        }
    unit = "deg" if spec.target == "angle" else "deg_per_step"
    notes: dict[str, object] = {
        **judged,
        "fitted": True,
        "filter_model": spec.filter,
        "terms" if spec.structure == "fos" else "cascades": learned.size,
        "training_rows": learned.fitted.record.samples,
        f"training_error_{unit}": math.degrees(learned.training_error),
        "training_explained_percent": 100.0 * learned.explained,
        "inputs_outside_training": learned.outside,
        "largest_correction_deg": math.degrees(float(learned.residual.abs().max())),
    }
    model = learned.fitted.model
    if isinstance(model, FosModel):
        notes["equation"] = model.equation(learned.fitted.record.source.inputs, spec.target)
    return notes
