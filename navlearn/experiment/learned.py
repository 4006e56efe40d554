"""Fitting an error model to the past of a drive, and judging it there."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel, TrainingRecord, TrainingSource
from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.error_models.storage import load_error_model
from navlearn.errors import ConfigError, FitError
from navlearn.experiment.correction import correct
from navlearn.frames import enu_between
from navlearn.learning.fit import fit_anarx
from navlearn.learning.ins_position_windows import InsOutages
from navlearn.learning.options import TrainingOptions
from navlearn.learning.pseudo_outages import (
    OUTPUTS,
    PseudoOutageOptions,
    PseudoOutages,
    emulate_outages,
    select_outages,
    training_windows,
)
from navlearn.learning.windows import Windows, select_windows
from navlearn.navigator import Navigator, NavigatorRun
from navlearn.recipe import Recipe
from navlearn.recipe.anarx_spec import AnarxSpec
from navlearn.states import Trajectory

SHARES = (0.6, 0.8)
"""Training ends at the first, validation at the second, the gate takes the rest."""


@dataclass(frozen=True, kw_only=True)
class Learned:
    """An error model and what its gate says of it.

    Attributes:
        fitted: The model with its record.
        verdict: Of the rolling-origin gate.
        example: Regressors of the last emulated outage, shape (S, m).
        trial: Record of the fit that was judged; that of ``fitted`` where it was not refused.
    """

    fitted: FittedErrorModel
    verdict: GateVerdict
    example: Tensor
    trial: TrainingRecord


def pseudo_outage_options(recipe: Recipe) -> PseudoOutageOptions:
    """Return how a recipe emulates outages: its training section, and what it calls good GNSS."""
    section = recipe.training
    return PseudoOutageOptions(
        horizon=section.horizon_s,
        every=section.restart_every_s,
        step=section.step_s,
        window=float("inf") if section.window_s is None else section.window_s,
        minimum_distance=section.minimum_distance,
        settle=section.settle_s,
        max_fix_interval=recipe.outages.max_fix_interval_s,
    )


def split_by_time(outages: PseudoOutages | InsOutages, gap: float) -> tuple[Tensor, Tensor, Tensor]:
    """Return which emulated outages train, validate, and judge, in order of time.

    No two parts share a second: an emulated outage that reaches into the next part, or comes
    within the gap of it, is dropped.

    Args:
        outages: Emulated outages.
        gap: Time left unused between the parts, s.

    Returns:
        Indices of the three parts.
    """
    start = outages.start_time
    horizon = float(outages.samples.dt[0].sum())
    edges = [float(start[0]) + share * float(start[-1] + horizon - start[0]) for share in SHARES]
    end = start + horizon
    train = end <= edges[0]
    valid = (start >= edges[0] + gap) & (end <= edges[1])
    judge = start >= edges[1] + gap
    return tuple(torch.nonzero(part).squeeze(-1) for part in (train, valid, judge))  # type: ignore[return-value]


def learn(
    recipe: Recipe,
    spec: AnarxSpec,
    navigator: Navigator,
    run: NavigatorRun,
    *,
    end: int,
    begin: float,
    log_name: str,
    regime: str = "online",
    progress: bool = False,
) -> Learned:
    """Fit an error model to what lies before a sample, and judge it there.

    The model on trial learns from the earlier part and is judged on the latest; a model that
    passes is fitted once more to the whole past, for as many iterations as validation wanted.

    Args:
        recipe: The recipe.
        spec: The model.
        navigator: What made the run.
        run: A run with fixes up to ``end``.
        end: Only samples before this one exist.
        begin: When the run's first interval begins, s from the start of the log.
        log_name: For the record.
        regime: For the record: ``online``, or ``other-drives`` for a model meant for those.
        progress: Show the training's progress.

    Returns:
        The model and its verdict.

    Raises:
        FitError: The past is too short to train, validate and judge.
    """
    options = pseudo_outage_options(recipe)
    outages = emulate_outages(navigator, run, options, end=end, begin=begin)
    windows = training_windows(outages, spec.inputs, spec.acts_on)
    source = TrainingSource(
        logs=(log_name,),
        regime=regime,
        acts_on=spec.acts_on,
        inputs=spec.inputs,
        outputs=OUTPUTS[spec.acts_on],
        time_step=recipe.training.step_s,
    )

    def fit(train: Windows, valid: Windows | None, training: TrainingOptions) -> FittedErrorModel:
        network = spec.anarx_options(outputs=len(OUTPUTS[spec.acts_on]))
        return fit_anarx(train, valid, network, training, source=source, progress=progress)

    def judged(trial: FittedErrorModel, index: Tensor) -> GateVerdict:
        return judge_on(trial, spec, navigator, select_outages(outages, index))

    parts = split_by_time(outages, recipe.training.gap_s)
    return fit_and_judge(windows, parts, spec.training_options(), fit, judged, spec.name)


def fit_and_judge(
    windows: Windows,
    parts: tuple[Tensor, Tensor, Tensor],
    training: TrainingOptions,
    fit: Callable[[Windows, Windows | None, TrainingOptions], FittedErrorModel],
    judged: Callable[[FittedErrorModel, Tensor], GateVerdict],
    name: str,
) -> Learned:
    """Fit a model to the earlier windows and judge it on the latest.

    One that passes is fitted once more to all, for as many iterations as validation wanted.

    Args:
        windows: Regressors and targets of emulated outages.
        parts: Which of them train, validate and judge, from :func:`split_by_time`.
        training: How the model is trained.
        fit: Fits a model to windows for training and validation.
        judged: Says whether a model helped on the emulated outages of an index.
        name: Name of the model, for messages.

    Raises:
        FitError: Too few windows.
    """
    train, valid, judge = parts
    if len(train) == 0 or len(valid) == 0:
        raise FitError(
            f"{name}: {len(windows.start_time)} emulated outages before the outage leave "
            f"{len(train)} to train and {len(valid)} to validate; start the outages later or "
            "shorten training.horizon_s"
        )
    trial = fit(select_windows(windows, train), select_windows(windows, valid), training)
    verdict = judged(trial, judge)
    fitted = trial
    if verdict.use:
        best = trial.curves.valid.index(min(trial.curves.valid))
        fitted = fit(windows, None, replace(training, max_iterations=max(best, 1)))
        # Nothing is left to validate on: what the trial showed on unseen windows is the honest
        # variance, not what remains on those that were fitted.
        fitted.model.register_buffer("variance", trial.model.get_buffer("variance").clone())
    return Learned(fitted=fitted, verdict=verdict, example=windows.u[-1], trial=trial.record)


def adopt(
    recipe: Recipe,
    spec: AnarxSpec,
    navigator: Navigator,
    run: NavigatorRun,
    *,
    end: int,
    begin: float,
    log_name: str,
) -> Learned:
    """Take a model that was fitted on other drives, and judge it on this one's past.

    Args:
        recipe: The recipe.
        spec: The model; its ``trained`` names the file.
        navigator: What made the run.
        run: A run with fixes up to ``end``.
        end: Only samples before this one exist.
        begin: When the run's first interval begins, s from the start of the log.
        log_name: The drive at hand, on which the model must not have been fitted.

    Returns:
        The model as it was saved, and its verdict.

    Raises:
        ConfigError: The model does another job than its spec says, or was fitted on this drive.
        FitError: The past holds no emulated outage to judge by.
    """
    if spec.trained is None:
        raise ConfigError(f"{spec.name}: its spec names no trained model")
    fitted = load_error_model(spec.trained)
    source = fitted.record.source
    for what, found, wanted in (
        ("inputs", source.inputs, spec.inputs),
        ("acts_on", source.acts_on, spec.acts_on),
        ("a time step of", source.time_step, recipe.training.step_s),
    ):
        if found != wanted:
            raise ConfigError(
                f"{spec.trained}: was trained with {what} {found}, but {spec.name} asks for "
                f"{wanted}; write its own into the spec, or train it anew"
            )
    if log_name in source.logs:
        raise ConfigError(
            f"{spec.trained}: was trained on {log_name} itself, so nothing could be judged by it; "
            "train it on other drives, or leave 'trained' out to learn before each outage"
        )
    options = pseudo_outage_options(recipe)
    outages = emulate_outages(navigator, run, options, end=end, begin=begin)
    verdict = judge_on(fitted, spec, navigator, outages)
    example = training_windows(outages, spec.inputs, spec.acts_on).u[-1]
    return Learned(fitted=fitted, verdict=verdict, example=example, trial=fitted.record)


def judge_on(
    fitted: FittedErrorModel, spec: AnarxSpec, navigator: Navigator, outages: PseudoOutages
) -> GateVerdict:
    """Return whether a model helped on emulated outages that it has not seen.

    Args:
        fitted: The model.
        spec: Its spec, for the gate's margin.
        navigator: What emulated the outages.
        outages: The emulated outages; there may be none.
    """
    if outages.start_time.numel() == 0:
        with_model = without = torch.zeros(0, dtype=torch.float64)
    else:
        corrected = correct(fitted, spec, navigator, outages)
        with_model = _largest_error(corrected, outages.reference)
        without = _largest_error(outages.predicted, outages.reference)
    found = rolling_origin_gate(
        with_model,
        without,
        margin=spec.safeguard.gate_margin,
        fewest=spec.safeguard.gate_fewest,
    )
    return found if spec.safeguard.gate else replace(found, use=True)


def _largest_error(trajectory: Trajectory, reference: Trajectory) -> Tensor:
    east, north, _ = enu_between(
        trajectory.lat, trajectory.lon, trajectory.height,
        reference.lat, reference.lon, reference.height,
    )  # fmt: skip
    return torch.hypot(east, north).amax(-1)
