"""Gyro error terms as states of the filter, as a method.

Two filters run over the drive: the honest one, and one with more of the gyro's errors among its
states. Outages are emulated all through the past; from each start both coast from what they
believed there, which rests on nothing later. The richer filter takes over only if it did better.
"""

import torch
from torch import Tensor

from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FilterDivergedError, FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.augmented_filter import AugmentedRun, augmented_run
from navlearn.experiment.baselines import FilterRuns, believed, believed_table
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.gyro_parameters import readable, readable_parameters
from navlearn.frames import enu_between
from navlearn.learning.pseudo_outages import PseudoOutageOptions, PseudoOutages, emulate_outages
from navlearn.logs.drive_log import DriveLog
from navlearn.navigator import Navigator, NavigatorRun
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.augmented_spec import AugmentedSpec
from navlearn.states import Trajectory


class AugmentedMethod:
    """The filter with more gyro states, or the honest one where the gate refuses them."""

    def __init__(self, runs: FilterRuns, spec: AugmentedSpec) -> None:
        """Make a method of a model.

        Args:
            runs: Filter runs, shared with the other methods.
            spec: The model.
        """
        self.runs, self.spec = runs, spec

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the prediction through an outage of the filter that did better before.

        Args:
            log: The drive up to the outage's end, without fixes from its start.
            outage: The outage.
        """
        timeline, navigator, honest = self.runs.run(log)
        t = timeline.t[honest.first :]
        solution = believed(honest.history)
        try:
            block, gone = last_fix(honest)
            augmented = augmented_run(self.runs, log, self.spec)
            verdict = self._judge(navigator, honest, augmented, gone)
        except (FitError, FilterDivergedError) as problem:
            notes: dict[str, object] = {"used": False, "reason": str(problem)}
            return Solution(table=believed_table(t, solution, outage), notes=notes)
        used = verdict.use or not self.spec.safeguard.gate
        if used:
            solution = augmented.solution(block)
        notes = gate_notes(verdict, self.spec.safeguard, used=used)
        notes["parameters"] = _parameters(augmented, block)
        return Solution(table=believed_table(t, solution, outage), notes=notes)

    def _judge(
        self, navigator: Navigator, honest: NavigatorRun, augmented: AugmentedRun, gone: int
    ) -> GateVerdict:
        """Return whether the augmented filter's beliefs coasted better than the honest ones'.

        Args:
            navigator: The honest filter.
            honest: Its run.
            augmented: The other run.
            gone: First sample without GNSS.
        """
        safeguard = self.spec.safeguard
        errors = torch.zeros(2, 0, dtype=torch.float64)
        try:
            emulated = judging_options(self.runs.recipe, self.spec)
            outages = emulate_outages(navigator, honest, emulated, end=gone)
            block, rows = places(outages, honest)
            later = Trajectory(*(channel[rows] for channel in augmented.run.history.trajectory))
            reference = midway(outages.reference, later)
            with_model = augmented.coast(block, rows)
            errors = torch.stack(
                [largest_error(path, reference) for path in (with_model, outages.predicted)]
            )
        except FitError:
            if safeguard.gate:
                raise
        return rolling_origin_gate(
            errors[0], errors[1], margin=safeguard.gate_margin, fewest=safeguard.gate_fewest
        )


def _parameters(augmented: AugmentedRun, block: int) -> dict[str, str]:
    """Return the gyro's parameters as known after a block."""
    options = augmented.navigator.options.filter
    told = readable_parameters(options, augmented.belief(block))
    if augmented.thermal is not None:
        known = augmented.thermal.known
        value, sigma = float(known.value[block]), float(known.sigma[block])
        told["temperature"] = readable("temperature", value, sigma)
    return told


def judging_options(recipe: Recipe, spec: AugmentedSpec) -> PseudoOutageOptions:
    """Return how the outages are emulated that judge a model.

    Args:
        recipe: Tells what good GNSS is, and how little driving teaches nothing.
        spec: The model.
    """
    return PseudoOutageOptions(
        horizon=spec.judge_s,
        every=spec.judge_every_s,
        settle=spec.judge_after_s,
        minimum_distance=recipe.training.minimum_distance,
        max_fix_interval=recipe.outages.max_fix_interval_s,
    )


def places(outages: PseudoOutages, run: NavigatorRun) -> tuple[Tensor, Tensor]:
    """Return after which blocks of a run emulated outages start, and their samples.

    Args:
        outages: Emulated outages, their times counted from the run's begin.
        run: The run.

    Returns:
        Blocks, int64, shape (N,), and samples, int64, shape (N, L).
    """
    dt = float(run.samples.dt.median())
    first = torch.round(outages.start_time / dt).long()
    rows = first.unsqueeze(-1) + torch.arange(outages.samples.dt.shape[-1])
    return torch.searchsorted(run.history.end, first - 1), rows


def midway(one: Trajectory, other: Trajectory) -> Trajectory:
    """Return the trajectory halfway between two, so that it favours neither.

    Args:
        one: What one filter knew, shape (...) each.
        other: What another knew at the same times, shape (...) each.
    """
    return Trajectory(*(0.5 * (a + b) for a, b in zip(one, other, strict=True)))


def largest_error(path: Trajectory, reference: Trajectory) -> Tensor:
    """Return the largest horizontal error of every emulated outage, m, shape (N,).

    Args:
        path: Mechanized without fixes, shape (N, L) each.
        reference: Where the car was, shape (N, L) each.
    """
    east, north, _ = enu_between(*path[:3], *reference[:3])
    return torch.hypot(east, north).amax(-1)
