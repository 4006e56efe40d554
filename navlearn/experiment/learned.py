"""Error models as methods: learned before the outage, run on their own output through it."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FitError
from navlearn.experiment.baselines import FilterRuns, solution_table
from navlearn.frames import enu_between
from navlearn.learning.fit import fit_anarx
from navlearn.learning.pseudo_outages import (
    OUTPUTS,
    PseudoOutageOptions,
    PseudoOutages,
    emulate_outages,
    step_regressors,
    training_windows,
)
from navlearn.learning.windows import Windows
from navlearn.logs.drive_log import DriveLog
from navlearn.navigator import Navigator, NavigatorRun, belief_at, without_position_error
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.spec import ModelSpec
from navlearn.states import RissSample, Trajectory

SHARES = (0.5, 0.75)
"""Training ends at the first, validation at the second, the gate takes the rest."""


@dataclass(frozen=True, kw_only=True)
class Learned:
    """An error model and what its gate says of it.

    Attributes:
        fitted: The model with its record.
        verdict: Of the rolling-origin gate.
        example: Regressors of the last emulated outage, shape (S, m).
    """

    fitted: FittedErrorModel
    verdict: GateVerdict
    example: Tensor


def pseudo_outage_options(recipe: Recipe) -> PseudoOutageOptions:
    """Return how a recipe's training section emulates outages."""
    section = recipe.training
    return PseudoOutageOptions(
        horizon=section.horizon_s,
        every=section.restart_every_s,
        step=section.step_s,
        window=float("inf") if section.window_s is None else section.window_s,
    )


def split_by_time(outages: PseudoOutages, gap: float) -> tuple[Tensor, Tensor, Tensor]:
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
    spec: ModelSpec,
    navigator: Navigator,
    run: NavigatorRun,
    *,
    end: int,
    log_name: str,
    progress: bool = False,
) -> Learned:
    """Fit an error model to what lies before a sample, and judge it there.

    Args:
        recipe: The recipe.
        spec: The model.
        navigator: What made the run.
        run: A run with fixes up to ``end``.
        end: Only samples before this one exist.
        log_name: For the record.
        progress: Show the training's progress.

    Returns:
        The model and its verdict.

    Raises:
        FitError: The past is too short to train, validate and judge.
    """
    outages = emulate_outages(navigator, run, pseudo_outage_options(recipe), end=end)
    windows = training_windows(outages, spec.inputs, spec.acts_on)
    train, valid, judge = split_by_time(outages, recipe.training.gap_s)
    if len(train) == 0 or len(valid) == 0:
        raise FitError(
            f"{spec.name}: {len(windows.start_time)} emulated outages before the outage leave "
            f"{len(train)} to train and {len(valid)} to validate; start the outages later or "
            "shorten training.horizon_s"
        )
    fitted = fit_anarx(
        _part(windows, train),
        _part(windows, valid),
        spec.anarx_options(outputs=len(OUTPUTS[spec.acts_on])),
        spec.training_options(),
        source=TrainingSource(
            logs=(log_name,),
            regime="online",
            acts_on=spec.acts_on,
            inputs=spec.inputs,
            outputs=OUTPUTS[spec.acts_on],
            time_step=recipe.training.step_s,
        ),
        progress=progress,
    )
    verdict = judge_on(fitted, spec, navigator, _outages_part(outages, judge))
    return Learned(fitted=fitted, verdict=verdict, example=windows.u[-1])


def judge_on(
    fitted: FittedErrorModel, spec: ModelSpec, navigator: Navigator, outages: PseudoOutages
) -> GateVerdict:
    """Return whether a model helped on emulated outages that it has not seen.

    Args:
        fitted: The model.
        spec: Its spec, for the gate's margin.
        navigator: What emulated the outages.
        outages: The emulated outages; there may be none.
    """
    if outages.start_time.numel() == 0:
        nothing = torch.zeros(0, dtype=torch.float64)
        found = rolling_origin_gate(nothing, nothing)
    else:
        corrected = correct(fitted, spec, navigator, outages)
        found = rolling_origin_gate(
            _largest_error(corrected, outages.reference),
            _largest_error(outages.predicted, outages.reference),
            margin=spec.safeguard.gate_margin,
            fewest=spec.safeguard.gate_fewest,
        )
    return found if spec.safeguard.gate else replace(found, use=True)


def predict(fitted: FittedErrorModel, spec: ModelSpec, samples: RissSample, block: int) -> Tensor:
    """Return what a model says of every sample through an outage that starts with them.

    Args:
        fitted: The model.
        spec: What it acts on, and its inputs.
        samples: Intervals, shape (..., L) each.
        block: Samples per step of the model.

    Returns:
        For ``azimuth_rate`` the error of the yaw rate, rad/s, shape (..., L, 1); for
        ``position`` increments of its error along and across, m, shape (..., L, 2).
    """
    length = samples.dt.shape[-1]
    with torch.no_grad():
        u = step_regressors(_whole_steps(samples, block), spec.inputs, block)
        increments: Tensor = fitted.model(u)
    each = (increments / block).repeat_interleave(block, dim=-2)[..., :length, :]
    if spec.acts_on == "azimuth_rate":
        # Azimuth turns against the yaw rate: too much azimuth is too little yaw rate.
        return -each / samples.dt.clamp(min=1e-9).unsqueeze(-1)
    return each


def correct(
    fitted: FittedErrorModel, spec: ModelSpec, navigator: Navigator, outages: PseudoOutages
) -> Trajectory:
    """Return emulated outages with the model's prediction taken off.

    Args:
        fitted: The model.
        spec: What it acts on, and its inputs.
        navigator: What emulated the outages.
        outages: Emulated outages.

    Returns:
        Trajectory, shape (N, L) each.
    """
    prediction = predict(fitted, spec, outages.samples, outages.block)
    if spec.acts_on == "azimuth_rate":
        return navigator.coast(outages.belief, outages.samples, prediction[..., 0])
    azimuth = outages.predicted.azimuth
    return without_position_error(
        outages.predicted, prediction[..., 0], prediction[..., 1], azimuth
    )


def _whole_steps(samples: RissSample, block: int) -> RissSample:
    """Return the samples of whole steps; the last step is filled up by repeating its end."""
    length = samples.dt.shape[-1]
    missing = -length % block
    if missing == 0:
        return samples
    return RissSample(
        *(
            torch.cat((channel, channel[..., -1:].expand(*channel.shape[:-1], missing)), -1)
            for channel in samples
        )
    )


def _largest_error(trajectory: Trajectory, reference: Trajectory) -> Tensor:
    east, north, _ = enu_between(
        trajectory.lat, trajectory.lon, trajectory.height,
        reference.lat, reference.lon, reference.height,
    )  # fmt: skip
    return torch.hypot(east, north).amax(-1)


def _part(windows: Windows, rows: Tensor) -> Windows:
    return Windows(windows.u[rows], windows.y[rows], windows.weight[rows], windows.start_time[rows])


def _outages_part(outages: PseudoOutages, rows: Tensor) -> PseudoOutages:
    belief = outages.belief
    return PseudoOutages(
        type(belief)(
            type(belief.state)(*(channel[rows] for channel in belief.state)),
            *(channel[rows] for channel in belief[1:]),
        ),
        RissSample(*(channel[rows] for channel in outages.samples)),
        Trajectory(*(channel[rows] for channel in outages.predicted)),
        Trajectory(*(channel[rows] for channel in outages.reference)),
        outages.start_time[rows],
        outages.block,
    )


class LearnedMethod:
    """The filter, and through the outage its prediction less what the error model predicts."""

    def __init__(self, runs: FilterRuns, spec: ModelSpec) -> None:
        self.runs, self.spec = runs, spec
        self.last: Learned | None = None

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the corrected prediction through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        timeline, navigator, run = self.runs.run(log, outage)
        t = timeline.t[run.first :]
        end = int((t < outage.start).sum())
        try:
            learned = learn(
                self.runs.recipe, self.spec, navigator, run, end=end, log_name=log.metadata.name
            )
        except FitError as problem:
            table = solution_table(t, run.history.trajectory, outage)
            return Solution(table=table, notes={"used": False, "reason": str(problem)})
        self.last = learned
        trajectory = run.history.trajectory
        if learned.verdict.use:
            trajectory = self._corrected(learned, navigator, run, end)
        step = max(1, round(self.runs.recipe.training.step_s / float(run.samples.dt.median())))
        through = RissSample(*(channel[end:] for channel in run.samples))
        u = step_regressors(_whole_steps(through, step), self.spec.inputs, step)
        notes = _notes(learned, u)
        return Solution(table=solution_table(t, trajectory, outage), notes=notes)

    def _corrected(
        self, learned: Learned, navigator: Navigator, run: NavigatorRun, end: int
    ) -> Trajectory:
        """Return the run's trajectory, corrected from its last block before ``end`` on."""
        history = run.history
        block = int((history.end < end).sum()) - 1
        first = int(history.end[block]) + 1
        samples = RissSample(*(channel[first:] for channel in run.samples))
        predicted = Trajectory(*(channel[first:] for channel in history.trajectory))
        step = max(1, round(self.runs.recipe.training.step_s / float(run.samples.dt.median())))
        prediction = predict(learned.fitted, self.spec, samples, step)
        if self.spec.acts_on == "azimuth_rate":
            better = navigator.filter_on(belief_at(history, block), samples, prediction[..., 0])
        else:
            better = without_position_error(
                predicted, prediction[..., 0], prediction[..., 1], predicted.azimuth
            )
        return Trajectory(
            *(
                torch.cat((whole[:first], part))
                for whole, part in zip(history.trajectory, better, strict=True)
            )
        )


def _notes(learned: Learned, u: Tensor) -> dict[str, object]:
    verdict, record = learned.verdict, learned.fitted.record
    model = learned.fitted.model
    notes: dict[str, object] = {
        "used": verdict.use,
        "reason": (
            f"rolling-origin gate: {100.0 * verdict.improvement:+.1f} % on {verdict.replays} "
            f"emulated outages, {100.0 * verdict.margin:g} % asked for"
        ),
        "gate_improvement_percent": 100.0 * verdict.improvement,
        "gate_replays": verdict.replays,
        "iterations": record.iterations,
        "train_loss": record.train_loss,
        "valid_loss": record.valid_loss,
    }
    if isinstance(model, Anarx):
        notes["inputs_outside_training"] = int(model.count_clamped(u).sum())
    return notes
