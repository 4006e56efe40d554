"""The papers' azimuth models as methods: trained beside a feed-forward filter, online.

Source: [Shen2010] §3.2 and Eq. (13), [Iqbal2020, VIII]. Through the outage the feed-forward
filter goes on without fixes, the model predicts ΔA from what that filter predicts, and a second
mechanization runs on odometer and A_mec − δA_KF − ΔA from where the last fix left the filter.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from navlearn.error_models.fos import FosModel
from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FilterDivergedError, FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.azimuth_model import AzimuthModel, fit_azimuth
from navlearn.experiment.baselines import (
    Believed,
    FilterRuns,
    believed,
    believed_table,
    filter_options,
)
from navlearn.experiment.feed_forward import FeedForward, run_feed_forward
from navlearn.experiment.learned import Learned, pseudo_outage_options
from navlearn.experiment.perfect_azimuth import reckoned
from navlearn.frames import enu_between
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.options import EkfOptions
from navlearn.learning.pseudo_outages import PseudoOutages, emulate_outages, select_outages
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.navigator import Navigator, NavigatorRun, belief_at
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.azimuth_spec import AzimuthSpec
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory


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
        timeline, navigator, run = self.runs.run(log)
        t = timeline.t[run.first :]
        plain = believed(run.history)
        try:
            _, gone = last_fix(run)
            beside = Beside(self.runs, self.spec, log, timeline, run)
            window = round(self.spec.window_s / beside.dt)
            path = beside.run([(gone - window, gone, len(run.samples.dt))])[0]
            learned = fit_azimuth(
                self.spec, beside.ekf.model, path, step=beside.step, log_name=log.metadata.name
            )
            begin = float(t[0] - run.samples.dt[0])
            verdict = self._verdict(beside, navigator, gone, begin)
        except (FitError, FilterDivergedError) as problem:
            if isinstance(problem, FilterDivergedError) and not self.spec.safeguard.gate:
                raise
            notes = {"used": False, "fitted": False, "reason": str(problem)}
            return Solution(table=believed_table(t, plain, outage), notes=notes)
        if self.keep is not None:
            example, record = learned.inputs[learned.origin :], learned.fitted.record
            self.keep(
                self.spec.name,
                Learned(fitted=learned.fitted, verdict=verdict, example=example, trial=record),
            )
        if verdict.use:
            plain = _joined(plain, path, steer(beside.options, path, learned))
        return Solution(
            table=believed_table(t, plain, outage), notes=_notes(self.spec, learned, verdict)
        )

    def _verdict(
        self, beside: "Beside", navigator: Navigator, gone: int, begin: float
    ) -> GateVerdict:
        """Return whether the model would have helped in the last emulated outages."""
        guard = self.spec.safeguard
        if not guard.gate:
            return GateVerdict(use=True, improvement=math.nan, replays=0, margin=guard.gate_margin)
        options = pseudo_outage_options(beside.runs.recipe)
        options = replace(
            options,
            every=max(options.every, 0.5 * options.horizon),
            settle=max(options.settle, self.spec.window_s + 2.0 * options.step),
        )
        emulated = emulate_outages(navigator, beside.closed, options, end=gone, begin=begin)
        count = len(emulated.start_time)
        recent = torch.arange(max(count - self.spec.gate_replays, 0), count)
        emulated = select_outages(emulated, recent)
        with_model, without = replayed(self.spec, beside, emulated, begin)
        return rolling_origin_gate(
            with_model, without, margin=guard.gate_margin, fewest=guard.gate_fewest
        )


class Beside:
    """The feed-forward filter of a spec on a drive, run over any spans of it."""

    def __init__(
        self,
        runs: FilterRuns,
        spec: AzimuthSpec,
        log: DriveLog,
        timeline: RissTimeline,
        run: NavigatorRun,
    ) -> None:
        self.runs, self.spec, self.honest = runs, spec, run
        closed = filter_options(runs.recipe, log=log)
        if spec.filter == "recipe":
            self.closed = run
        else:
            closed = replace(closed, model=spec.filter)
            self.closed = runs.run(log, closed)[2]
        self.options: EkfOptions = replace(closed, feedback="open")
        self.ekf = LooselyCoupledEkf(self.options)
        self.dt = float(run.samples.dt.median())
        self.step = runs.recipe.training.step_s
        later = timeline.timing.index >= run.first
        self.fixes = GnssFix(*(channel[later] for channel in timeline.fixes))
        self.timing = FixTiming(
            timeline.timing.index[later] - run.first, timeline.timing.delay[later]
        )

    def run(self, spans: list[tuple[int, int, int]]) -> list[FeedForward]:
        """Return a run per span: begin, first interval without GNSS, and end."""
        return run_feed_forward(self.ekf, self.closed, self.fixes, self.timing, spans)


def steer(options: EkfOptions, run: FeedForward, learned: AzimuthModel) -> Trajectory:
    """Return the second mechanization through an outage.

    Args:
        options: The feed-forward filter's options.
        run: Its run over window and outage.
        learned: What its azimuth is less.

    Returns:
        Trajectory from the first interval without GNSS on, shape (L,) each.
    """
    samples = RissSample(*(channel[run.gone :] for channel in run.samples))
    clock = torch.cumsum(run.samples.dt, -1)[run.gone - 1 :]
    azimuth = run.history.trajectory.azimuth[run.gone - 1 :] - learned.at(clock)
    block = int(torch.nonzero(run.history.end < run.gone)[-1])
    belief = belief_at(run.history, block)
    middle = 0.5 * (azimuth[1:] + azimuth[:-1])
    return reckoned(options, belief, samples, middle)._replace(azimuth=azimuth[1:])


def replayed(
    spec: AzimuthSpec, beside: Beside, emulated: PseudoOutages, begin: float
) -> tuple[Tensor, Tensor]:
    """Return the largest error of emulated outages with the model and without.

    Args:
        spec: The model, fitted anew before each of them.
        beside: The feed-forward filter.
        emulated: The emulated outages.
        begin: When the run's first interval begins, s.

    Returns:
        Errors with and without the model, m, shape (M,) each; outages before which nothing could
        be fitted are left out.
    """
    length = emulated.samples.dt.shape[-1]
    window = round(spec.window_s / beside.dt)
    first = [round((start - begin) / beside.dt) for start in emulated.start_time.tolist()]
    paths, kept = [], []
    runs = beside.run([(gone - window, gone, gone + length) for gone in first])
    for k, run in enumerate(runs):
        try:
            learned = fit_azimuth(spec, beside.ekf.model, run, step=beside.step)
        except FitError:
            continue
        paths.append(steer(beside.options, run, learned))
        kept.append(k)
    if not kept:
        none = torch.zeros(0, dtype=torch.float64)
        return none, none
    emulated = select_outages(emulated, torch.tensor(kept))
    path = Trajectory(*(torch.stack(channel) for channel in zip(*paths, strict=True)))
    return _largest(path, emulated.reference), _largest(emulated.predicted, emulated.reference)


def _largest(path: Trajectory, reference: Trajectory) -> Tensor:
    east, north, _ = enu_between(
        path.lat, path.lon, path.height, reference.lat, reference.lon, reference.height
    )
    return torch.hypot(east, north).amax(-1)


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
    found = (
        f"{100.0 * verdict.improvement:+.1f} % on {verdict.replays} emulated outages"
        if verdict.replays
        else "no emulated outage to judge by"
    )
    reason = (
        f"rolling-origin gate: {found}, {100.0 * verdict.margin:g} % on at least "
        f"{spec.safeguard.gate_fewest} asked for"
        if spec.safeguard.gate
        else "no gate: the spec switches it off, as the paper has none"
    )
    unit = "deg" if spec.target == "angle" else "deg_per_s"
    notes: dict[str, object] = {
        "used": verdict.use,
        "fitted": True,
        "reason": reason,
        "filter_model": spec.filter,
        "terms" if spec.structure == "fos" else "cascades": learned.size,
        "training_rows": learned.fitted.record.samples,
        f"training_error_{unit}": math.degrees(learned.training_error),
        "training_explained_percent": 100.0 * learned.explained,
        "inputs_outside_training": learned.outside,
        "largest_correction_deg": math.degrees(float(learned.residual.abs().max())),
    }
    if spec.safeguard.gate:
        notes["gate_improvement_percent"] = 100.0 * verdict.improvement
        notes["gate_replays"] = verdict.replays
    model = learned.fitted.model
    if isinstance(model, FosModel):
        notes["equation"] = model.equation(learned.fitted.record.source.inputs, spec.target)
    return notes
