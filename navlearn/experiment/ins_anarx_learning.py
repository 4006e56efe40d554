"""Learning what the full-IMU filter's coast does wrong, judging it, and taking it off."""

from dataclasses import replace

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.experiment.ins_anarx_diagnostics import Diagnose, sound_diagnostics
from navlearn.experiment.learned import (
    Learned,
    fit_and_judge,
    pseudo_outage_options,
    split_by_time,
)
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
from navlearn.recipe import Recipe
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.states import ImuSample, InsState


def learn_on_coasts(
    spec: InsAnarxSpec,
    recipe: Recipe,
    navigator: InsNavigator,
    run: InsNavigatorRun,
    *,
    end: int,
    begin: float,
    log_name: str,
    diagnose: Diagnose | None = None,
) -> tuple[Learned, InsOutages]:
    """Fit a model to what lies before a sample, and judge it there.

    Args:
        spec: The model.
        recipe: Its ``training`` section tells how outages are emulated.
        navigator: What made the run.
        run: A run with fixes up to ``end``.
        end: Only samples before this one exist.
        begin: When the run's first interval begins, s from the start of the log.
        log_name: For the record.
        diagnose: Called with the diagnostics of the model that was on trial.

    Returns:
        The model with its verdict, and the outages that it learned from.

    Raises:
        FitError: The past is too short to train, validate and judge.
    """
    outages = emulate_ins_outages(
        navigator.filter,
        run.samples,
        run.history,
        pseudo_outage_options(recipe),
        method=navigator.options.method,
        end=end,
        begin=begin,
    )
    windows = ins_training_windows(navigator.filter, outages, spec.inputs)
    source = TrainingSource(
        logs=(log_name,),
        acts_on="position",
        inputs=spec.inputs,
        outputs=INS_OUTPUTS,
        time_step=recipe.training.step_s,
        input_units=tuple(INS_CHANNELS[name] for name in spec.inputs),
    )
    trials: list[FittedErrorModel] = []

    def fit(train: Windows, valid: Windows | None, how: TrainingOptions) -> FittedErrorModel:
        network = spec.anarx_options(outputs=len(INS_OUTPUTS))
        trials.append(fit_anarx(train, valid, network, how, source=source, progress=False))
        return trials[-1]

    def judged(trial: FittedErrorModel, index: Tensor) -> GateVerdict:
        return judge_on_coasts(trial, spec, select_ins_outages(outages, index), windows.u[index])

    parts = split_by_time(outages, recipe.training.gap_s)
    learned = fit_and_judge(windows, parts, spec.training_options(), fit, judged, spec.name)
    if diagnose is not None:
        diagnose(spec.name, sound_diagnostics(spec, trials[0], windows, parts))
    return learned, outages


def judge_on_coasts(
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


def corrected_coast(
    navigator: InsNavigator,
    run: InsNavigatorRun,
    inputs: tuple[str, ...],
    block: int,
    step: int,
    learned: Learned,
    stop: int | None = None,
) -> tuple[Tensor, InsState]:
    """Return the regressors of a run's coast, and the coast less what the model says of it.

    Args:
        navigator: What made the run.
        run: The run; from ``block`` on it coasts.
        inputs: Names of the regressors.
        block: The block that ends with the last fix.
        step: Samples per step of the model.
        learned: The model.
        stop: The sample at which the coast ends; None takes all.
    """
    gone = slice(int(run.history.end[block]) + 1, stop)
    samples = ImuSample(*(_whole_steps(channel[gone], step) for channel in run.samples))
    coast = InsState(*(channel[gone] for channel in run.history.trajectory))
    whole = InsState(*(_whole_steps(channel, step) for channel in coast))
    belief = ins_belief_at(run.history, block)
    start = map_ins_belief(belief, lambda channel: channel.unsqueeze(0))
    u = coast_inputs(navigator.filter, start, samples, whole, inputs, step)[0]
    with torch.no_grad():
        increments: Tensor = learned.fitted.model(u)
    return u, without_increments(coast, increments, step)


def _whole_steps(channel: Tensor, step: int) -> Tensor:
    """Return a channel as a batch of one, its last step filled up by repeating its end."""
    missing = -len(channel) % step
    if missing:
        channel = torch.cat((channel, channel[-1:].expand(missing, *channel.shape[1:])))
    return channel.unsqueeze(0)
