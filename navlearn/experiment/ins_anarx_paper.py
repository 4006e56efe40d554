"""ANARX as [Jaradat2017] prints it, as a method: a free-running INS plus three networks.

No filter takes part: with fixes the networks learn δP = GNSS − INS, without them they run on
their own output and P' = INS + δP, (16). Velocity and attitude stay those of the INS, which the
paper does not correct. Where a spec asks for the gate, the networks must first beat the full-IMU
filter in outages emulated in the latest part of the window; refused, the answer is the filter's.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import torch
from torch import Tensor

from navlearn.error_models.base import TrainingSource
from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FilterDivergedError, FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.ins_anarx_data import FreeIns, free_ins
from navlearn.experiment.ins_anarx_diagnostics import Diagnose, paper_diagnostics
from navlearn.experiment.ins_anarx_learning import largest_error
from navlearn.experiment.ins_filter_runs import InsFilterRuns
from navlearn.experiment.learned import pseudo_outage_options
from navlearn.experiment.solution_tables import ins_solution_table, with_deviations
from navlearn.frames import geodetic_from_ecef
from navlearn.ins_navigator import InsNavigator, InsNavigatorRun
from navlearn.learning.ins_position_windows import emulate_ins_outages
from navlearn.learning.position_fit import (
    AXES,
    AxisFit,
    PositionFitOptions,
    fit_position,
    run_on_own_output,
)
from navlearn.learning.position_series import (
    SERIES_INPUTS,
    PositionSeries,
    without_fixes_after,
)
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.states import InsState

JUDGED_FROM: Final = 0.6
"""Share of the window that a model on trial learns from; the gate takes the rest."""


class PaperAnarxMethod:
    """A free-running INS with the position error that three networks add to it."""

    def __init__(
        self, runs: InsFilterRuns, spec: InsAnarxSpec, diagnose: Diagnose | None = None
    ) -> None:
        """Make a method of a model.

        Args:
            runs: Filter runs, shared with the other methods.
            spec: The model.
            diagnose: Called with the diagnostics of each fit, before its solution is returned.
        """
        self.runs, self.spec, self.diagnose = runs, spec, diagnose

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return INS plus networks through an outage, or the filter where a gate refuses them.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.

        Raises:
            FilterDivergedError: The networks ran away.
        """
        line, navigator, run = self.runs.run(log)
        t = line.t[run.first :]
        try:
            since = None if self.spec.window_s is None else outage.start - self.spec.window_s
            free = free_ins(line, navigator, run, since=since)
            verdict = self._verdict(navigator, run, free, float(t[0] - run.samples.dt[0]))
            fits = self._fit(free.series, log.metadata.name)
        except FitError as problem:
            return _of_the_filter(t, run, outage, {"used": False, "reason": str(problem)})
        self._diagnose(fits, free.series)
        gate = gate_notes(verdict, self.spec.safeguard, used=verdict.use)
        notes = {**gate, **_notes(fits, free)}
        if not verdict.use:
            return _of_the_filter(t, run, outage, notes)
        path = fused_path(fits, free, self.spec.inputs, run)
        return Solution(table=ins_solution_table(t, path, outage), notes=notes)

    def _fit(self, series: PositionSeries, log_name: str) -> tuple[AxisFit, ...]:
        source = TrainingSource(
            logs=(log_name,),
            acts_on="position",
            inputs=self.spec.inputs,
            outputs=("error",),
            time_step=float(series.t.diff().median()),
            input_units=tuple(SERIES_INPUTS[name] for name in self.spec.inputs),
        )
        return fit_position(series, fit_options(self.spec, self.runs.recipe, series), source)

    def _verdict(
        self, navigator: InsNavigator, run: InsNavigatorRun, free: FreeIns, begin: float
    ) -> GateVerdict:
        """Return whether networks that saw the earlier part beat the filter on the later one."""
        safeguard = self.spec.safeguard
        if not safeguard.gate:
            return GateVerdict(
                use=True, improvement=float("nan"), replays=0, margin=safeguard.gate_margin
            )
        series = free.series
        early = torch.nonzero(series.at_fix).squeeze(-1)
        cut = int(early[early <= JUDGED_FROM * int(series.known.sum())][-1])
        fits = self._fit(without_fixes_after(series, cut), "trial")
        options = pseudo_outage_options(self.runs.recipe)
        judged_from = float(series.t[cut]) - begin + self.runs.recipe.training.gap_s
        _, gone = last_fix(run)
        outages = emulate_ins_outages(
            navigator.filter,
            run.samples,
            run.history,
            replace(options, settle=max(options.settle, judged_from)),
            method=navigator.options.method,
            end=gone,
            begin=begin,
        )
        last = torch.searchsorted(series.t, outages.start_time + 1e-6, right=True) - 1
        length = outages.predicted.lat.shape[-1]
        paths = [self._emulated(fits, free, int(row), length) for row in last]
        path = InsState(*(torch.stack(channel) for channel in zip(*paths, strict=True)))
        return rolling_origin_gate(
            largest_error(path, outages.reference),
            largest_error(outages.predicted, outages.reference),
            margin=safeguard.gate_margin,
            fewest=safeguard.gate_fewest,
        )

    def _emulated(
        self, fits: tuple[AxisFit, ...], free: FreeIns, row: int, length: int
    ) -> InsState:
        """Return INS plus networks over rows after one, as if no fix came any more."""
        cut = PositionSeries(*(channel[: row + 1 + length] for channel in free.series))
        withheld = without_fixes_after(cut, row)
        error = run_on_own_output(fits, withheld, self.spec.inputs, after=row)
        rows = slice(row + 1, row + 1 + length)
        return _moved(InsState(*(channel[rows] for channel in free.path)), withheld, error)

    def _diagnose(self, fits: tuple[AxisFit, ...], series: PositionSeries) -> None:
        if self.diagnose is not None:
            fused = series.ins[1:] + run_on_own_output(fits, series, self.spec.inputs)
            self.diagnose(self.spec.name, paper_diagnostics(self.spec, fits, series, fused))


def fit_options(spec: InsAnarxSpec, recipe: Recipe, series: PositionSeries) -> PositionFitOptions:
    """Return how the networks of a spec are trained on a record.

    Args:
        spec: The model.
        recipe: Its ``training`` section tells how long a free run is, and the gap.
        series: Tells the sampling interval.
    """
    dt, section = float(series.t.diff().median()), recipe.training
    return PositionFitOptions(
        network=spec.anarx_options(outputs=1),
        training=spec.training_options(),
        inputs=spec.inputs,
        split=spec.split,
        gap=round(section.gap_s / dt),
        length=round(section.horizon_s / dt),
        stride=round(section.restart_every_s / dt),
        fixes_only=spec.targets == "at_fixes",
    )


def fused_path(
    fits: tuple[AxisFit, ...], free: FreeIns, inputs: tuple[str, ...], run: InsNavigatorRun
) -> InsState:
    """Return a run's path, from its last fix on that of INS plus networks.

    Args:
        fits: A network per axis.
        free: The INS and its record, to the end of the run.
        inputs: Names of the regressors.
        run: The filter's run.

    Raises:
        FilterDivergedError: The networks ran away.
    """
    series = free.series
    last = int(series.known.sum()) - 1
    error = run_on_own_output(fits, series, inputs, after=last)
    after = _moved(InsState(*(channel[last + 1 :] for channel in free.path)), series, error)
    gone = free.first + last + 1
    before = (channel[:gone] for channel in run.history.trajectory)
    return InsState(*(torch.cat(pair) for pair in zip(before, after, strict=True)))


def _moved(free: InsState, series: PositionSeries, error: Tensor) -> InsState:
    """Return the last rows of an INS with its predicted position error added."""
    position = series.ins[len(series.ins) - len(error) :] + error
    if not bool(torch.isfinite(position).all()):
        raise FilterDivergedError(
            "ANARX: its own output ran away to infinity; train it in closed loop, or switch its "
            "safeguard's bounds on"
        )
    lat, lon, height = geodetic_from_ecef(position)
    return free._replace(lat=lat, lon=lon, height=height)


def _of_the_filter(
    t: Tensor, run: InsNavigatorRun, outage: Outage, notes: Mapping[str, object]
) -> Solution:
    table = ins_solution_table(t, run.history.trajectory, outage)
    covariance = run.history.belief.covariance[..., :2, :2]
    return Solution(table=with_deviations(table, t[run.history.end], covariance), notes=notes)


def _notes(fits: tuple[AxisFit, ...], free: FreeIns) -> dict[str, object]:
    records = [fit.fitted.record for fit in fits]
    return {
        "free_ins_s": float(free.series.t[-1] - free.series.t[0]),
        **{f"iterations_{a}": r.iterations for a, r in zip(AXES, records, strict=True)},
        **{f"train_loss_{a}": r.train_loss for a, r in zip(AXES, records, strict=True)},
        **{f"valid_loss_{a}": r.valid_loss for a, r in zip(AXES, records, strict=True)},
    }
