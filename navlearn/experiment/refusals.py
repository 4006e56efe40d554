"""What the filters of a recipe refused over its whole drive, for results and report.

Each filter runs once over the drive with all its fixes. Filters know nothing of what comes later,
so up to the start of an outage this is what the method that was scored there believed and refused.
"""

from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from navlearn.errors import FilterDivergedError
from navlearn.experiment.baselines import FilterMethod, FilterRuns, filter_options
from navlearn.experiment.ins_filter_runs import InsFilterRuns, ins_filter_options
from navlearn.experiment.ins_methods import InsFilterMethod
from navlearn.experiment.methods import FIXED, MethodContext
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.experiment.tight_method import TightMethod
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.measurements import Kind, Rows, Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.robust import weights
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.navigator import Navigator, NavigatorRun
from navlearn.outages.refused_fixes import Judgements
from navlearn.outages.refused_ranges import RangeJudgements
from navlearn.outages.refused_report import Refusals
from navlearn.outages.replay import Method
from navlearn.outages.roles import ORACLES
from navlearn.recipe import Recipe
from navlearn.states import FixTiming, GnssFix

Filtering = FilterMethod | InsFilterMethod | TightMethod
FILTERING: Final = (FilterMethod, InsFilterMethod, TightMethod)
"""Methods that are nothing but a filter."""


class _History(Protocol):
    @property
    def end(self) -> Tensor: ...

    @property
    def fix(self) -> Tensor: ...

    @property
    def innovation(self) -> Tensor: ...

    @property
    def nis(self) -> Tensor: ...

    @property
    def verdict(self) -> Tensor: ...


class _Line(Protocol):
    @property
    def t(self) -> Tensor: ...

    @property
    def fixes(self) -> GnssFix: ...

    @property
    def timing(self) -> FixTiming: ...

    @property
    def fix_time(self) -> Tensor: ...


class _Gated(NamedTuple):
    """What a filter's verdicts hang on."""

    rows: Rows
    limits: tuple[float, ...]
    gate: GateOptions
    kinds: type[IntEnum]


def filters_of(recipe: Recipe) -> dict[str, Method]:
    """Return the methods of a recipe that are nothing but a filter, by name.

    Args:
        recipe: The recipe.
    """
    context = MethodContext(
        recipe=recipe,
        runs=FilterRuns(recipe),
        ins_runs=InsFilterRuns(recipe),
        tight_runs=TightFilterRuns(recipe),
    )
    names = [name for name in recipe.methods if name in FIXED and name not in ORACLES]
    made = {name: FIXED[name](context) for name in names}
    return {name: method for name, method in made.items() if isinstance(method, FILTERING)}


def refusals(methods: Mapping[str, Method], log: DriveLog) -> dict[str, Refusals | str]:
    """Return what every method that is a filter refused over a drive.

    Args:
        methods: By name; those that are something else are left out.
        log: The whole drive.

    Returns:
        By name; a sentence where a filter was lost.
    """
    found: dict[str, Refusals | str] = {}
    for name, method in methods.items():
        if isinstance(method, FILTERING):
            try:
                found[name] = refused_by(method, log)
            except FilterDivergedError as lost:
                found[name] = str(lost)
    return found


def refused_by(method: Filtering, log: DriveLog) -> Refusals:
    """Return what a filter refused over a drive.

    Args:
        method: The filter as a method.
        log: The whole drive.

    Raises:
        FilterDivergedError: It was lost on the way.
    """
    if isinstance(method, TightMethod):
        return _tight(method, log)
    if isinstance(method, InsFilterMethod):
        chosen = ins_filter_options(method.runs.recipe, method.method, log)
        ins_line, ins_navigator, ins_run = method.runs.run(log, chosen)
        ins = ins_navigator.filter.model
        gated = _Gated(ins.rows, ins.limits, chosen.gate, InsKind)
        return Refusals(fixes=_judgements(ins_line, ins_run.first, ins_run.history, gated))
    options = filter_options(method.runs.recipe, method.method, log)
    return Refusals(fixes=riss_judgements(*method.runs.run(log, options)))


def riss_judgements(line: RissTimeline, navigator: Navigator, run: NavigatorRun) -> Judgements:
    """Return what a loosely coupled filter of one gyro made of its measurements.

    Args:
        line: The log as tensors.
        navigator: What ran.
        run: Its run.
    """
    model = navigator.filter.model
    gated = _Gated(model.rows, model.limits, navigator.options.filter.gate, Kind)
    return _judgements(line, run.first, run.history, gated)


def _judgements(line: _Line, first: int, history: _History, gated: _Gated) -> Judgements:
    used = line.timing.index >= first
    at = history.fix.clamp(min=0)
    t = line.t[first + history.end]
    stated = torch.full((len(t), gated.rows.known), torch.nan, dtype=t.dtype)
    if bool(used.any()):
        fixes = GnssFix(*(channel[used][at] for channel in line.fixes))
        there = history.fix >= 0
        t = torch.where(there, line.fix_time[used][at], t)
        horizontal = torch.sqrt(0.5 * (fixes.std_e**2 + fixes.std_n**2))
        # positions and velocities come first in every family of filters
        stated[:, 0] = torch.where(there, horizontal, torch.nan)
        stated[:, 1] = torch.where(there, fixes.std_v, torch.nan)
    return _judged(t, gated, stated, history.innovation, history.nis, history.verdict)


def _judged(
    t: Tensor, gated: _Gated, stated: Tensor, innovation: Tensor, nis: Tensor, verdict: Tensor
) -> Judgements:
    weight = weights(gated.gate, gated.rows, nis, verdict)
    weight = torch.ones_like(nis) if weight is None else weight
    believed = torch.where(_refused(verdict), 0.0, weight)
    limit = np.full(gated.rows.known, np.nan)
    limit[[int(kind) for kind in gated.rows.kinds]] = gated.limits
    return Judgements(
        t=t.numpy(),
        rows=gated.rows,
        kinds=tuple(kind.name.lower() for kind in gated.kinds),
        innovation=innovation.detach().numpy(),
        nis=nis.detach().numpy(),
        verdict=verdict.numpy(),
        weight=believed.detach().numpy(),
        stated=stated.numpy(),
        nis_limit=limit,
        limits={
            int(Verdict.REFUSED_BY_PREDICTION): gated.gate.prediction_limit,
            int(Verdict.REFUSED_BY_MOTION): gated.gate.motion_limit,
        },
    )


def _refused(verdict: Tensor) -> Tensor:
    by = (Verdict.REFUSED_BY_GATE, Verdict.REFUSED_BY_PREDICTION, Verdict.REFUSED_BY_MOTION)
    return torch.isin(verdict, torch.tensor([int(one) for one in by]))


def _tight(method: TightMethod, log: DriveLog) -> Refusals:
    line, series, navigator, run = method.runs.run(log, method.method)
    history, vehicle = run.history, navigator.vehicle
    t = line.t[run.first + history.end]
    kinds = Kind if isinstance(navigator.options.vehicle, EkfOptions) else InsKind
    gated = _Gated(vehicle.rows, vehicle.limits, navigator.options.vehicle.gate, kinds)
    nothing = torch.full((len(t), gated.rows.known), torch.nan, dtype=t.dtype)
    own = _judged(t, gated, nothing, history.own_innovation, history.own_nis, history.own_verdict)
    heard = series.t[series.timing.index >= run.first]
    there = history.reception >= 0
    if len(heard):
        t = torch.where(there, heard[history.reception.clamp(min=0)], t)
    ranges = RangeJudgements(
        t=t.numpy(),
        satellites=series.satellites,
        innovation=torch.cat((history.innovation, history.rate_innovation), -1).detach().numpy(),
        nis=history.nis.detach().numpy(),
        verdict=history.verdict.numpy(),
        nis_limit=navigator.filter(len(series.systems)).model.limit,
    )
    return Refusals(fixes=own, ranges=ranges)
