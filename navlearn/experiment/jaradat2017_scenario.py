"""The simulated scenario of [Jaradat2017] §IV, method beside method, judged by the truth.

The paper trains on a record and shows its networks on the same record, and so does this. Every
method sees fixes alone: the truth judges. Errors are estimate − truth along Earth-fixed axes.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Final

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from navlearn.errors import LogError
from navlearn.experiment.ins_anarx_data import FreeIns, free_ins
from navlearn.experiment.ins_anarx_learning import corrected_coast, learn_on_coasts
from navlearn.experiment.ins_anarx_paper import fit_options
from navlearn.experiment.ins_filter_runs import InsFilterRuns
from navlearn.frames import ecef_from_geodetic
from navlearn.ins_navigator import InsNavigatorRun
from navlearn.learning.position_fit import AXES, fit_position, run_on_own_output
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import jaradat2017_scenario
from navlearn.recipe import Recipe
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.states import InsState

SCENARIO: Final[dict[str, Any]] = {
    "question": "What do the networks of [Jaradat2017] make of that paper's own scenario?",
    "log": {"simulated": {"profile": "jaradat2017"}},
    "mechanization": {"sensors": "imu"},
    # The vehicle of the paper is no car: it slips sideways and rises, and has no odometer.
    "ins_filter": dict.fromkeys(
        ("odometer", "nonholonomic", "zero_velocity", "zero_angular_rate"), False
    ),
    "training": {
        "horizon_s": 4.0,
        "restart_every_s": 1.0,
        "step_s": 0.2,
        "gap_s": 1.0,
        "minimum_distance": 1.0,
        "settle_s": 10.0,
    },
}
"""What a recipe for the scenario says; emulated outages have about the length of a missed fix."""


def scenario_recipe(name: str = "jaradat2017_scenario") -> Recipe:
    """Return the recipe that the comparison follows.

    Args:
        name: Its name.
    """
    return Recipe.model_validate({"name": name, "methods": ["ins_ekf"], **SCENARIO})


def compare_on_scenario(
    seed: int, specs: Iterable[InsAnarxSpec], recipe: Recipe | None = None
) -> pd.DataFrame:
    """Return what every method makes of one draw of the scenario.

    No gate is asked: every model acts, a sound one from the fix before each missing fix until it.

    Args:
        seed: Of the draw.
        specs: Models to compare.
        recipe: How; None stands for :func:`scenario_recipe`.

    Returns:
        Rows of ``seed``, ``method``, ``measure`` (``training residual``, ``test residual``:
        prediction − target of the paper's networks; ``in use``: error of the path at every IMU
        step; ``missed fixes``: the same where a fix is missing), ``axis``, ``count``, ``mean``
        (m), ``rms`` (m).
    """
    chosen = scenario_recipe() if recipe is None else recipe
    log = jaradat2017_scenario(seed).log
    line, navigator, run = InsFilterRuns(chosen).run(log)
    free = free_ins(line, navigator, run)
    truth = true_positions(log, free.series.t)
    missed = missed_rows(free)
    paths = {"ins": free.series.ins, "last fix": free.series.held}
    paths["ins_ekf"] = _ecef(
        InsState(*(channel[free.first :] for channel in run.history.trajectory))
    )
    rows: list[dict[str, object]] = []
    for spec in specs:
        if spec.mode == "paper":
            fits = fit_position(free.series, fit_options(spec, chosen, free.series))
            error = run_on_own_output(fits, free.series, spec.inputs)
            paths[spec.name] = torch.cat((free.series.held[:1], free.series.ins[1:] + error))
            for axis, fit in zip(AXES, fits, strict=True):
                residual = fit.predicted - fit.windows.windows.y.squeeze(-1)
                for part, measure in ((0, "training residual"), (2, "test residual")):
                    found = residual[fit.windows.part == part]
                    rows.append(_row(spec.name, measure, axis, found))
        else:
            begin = float(line.t[run.first] - run.samples.dt[0])
            learned, outages = learn_on_coasts(
                spec, chosen, navigator, run,
                end=len(run.samples.dt), begin=begin, log_name=log.metadata.name,
            )  # fmt: skip
            correct = partial(
                corrected_coast, navigator, run, spec.inputs, step=outages.block, learned=learned
            )
            paths[spec.name] = _through_gaps(correct, run, free, paths["ins_ekf"], missed)
    for name, path in paths.items():
        for axis, error in zip(AXES, (path - truth).unbind(-1), strict=True):
            rows.append(_row(name, "in use", axis, error[1:]))
            rows.append(_row(name, "missed fixes", axis, error[missed]))
    return pd.DataFrame(rows).assign(seed=seed)


def missed_rows(free: FreeIns) -> Tensor:
    """Return the rows at which a fix was due and none came, int64.

    Args:
        free: The INS and its record.
    """
    at = torch.nonzero(free.series.at_fix).squeeze(-1)
    gaps = at.diff()
    every = int(gaps.median())
    missing = torch.round(gaps / every).to(torch.int64) - 1
    rows = [int(at[k]) + every * (j + 1) for k, n in enumerate(missing.tolist()) for j in range(n)]
    return torch.tensor(rows, dtype=torch.int64)


def _through_gaps(
    correct: Callable[..., tuple[Tensor, InsState]],
    run: InsNavigatorRun,
    free: FreeIns,
    path: Tensor,
    missed: Tensor,
) -> Tensor:
    """Return the filter's path, corrected from the fix before each missing one until it."""
    path, with_fix = path.clone(), run.history.fix >= 0
    for row in missed.tolist():
        sample = free.first + row
        block = int(torch.nonzero(with_fix & (run.history.end < sample))[-1])
        _, better = correct(block=block, stop=sample + 1)
        begin = int(run.history.end[block]) + 1 - free.first
        path[begin : row + 1] = _ecef(better)
    return path


def _ecef(path: InsState) -> Tensor:
    return ecef_from_geodetic(path.lat, path.lon, path.height)


def true_positions(log: DriveLog, t: Tensor) -> Tensor:
    """Return the true positions at some times, Earth-fixed, m, shape (T, 3).

    Args:
        log: A log with its reference.
        t: Times, s, shape (T,).

    Raises:
        LogError: The log has no reference.
    """
    if log.reference is None:
        raise LogError(f"{log.metadata.name}: has no reference; the scenario needs its truth")
    known = log.reference
    place = [torch.tensor(known[name].to_numpy()) for name in ("lat", "lon", "height")]
    position = ecef_from_geodetic(*place).numpy()
    at = [np.interp(t.numpy(), known["t"].to_numpy(), column) for column in position.T]
    return torch.from_numpy(np.stack(at, -1))


def _row(method: str, measure: str, axis: str, error: Tensor) -> dict[str, object]:
    return {
        "method": method,
        "measure": measure,
        "axis": axis,
        "count": error.numel(),
        "mean": float(error.mean()),
        "rms": float(error.square().mean().sqrt()),
    }
