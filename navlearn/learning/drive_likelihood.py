"""A drive made ready to be judged again and again by filters that differ in their noise."""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import FilterDivergedError, LogError
from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.batch_axis import unsqueezed
from navlearn.fusion.checks import check_inputs
from navlearn.fusion.fast import run_fast
from navlearn.fusion.filter_model import FilterModel, filter_model
from navlearn.fusion.first_guess import first_guess
from navlearn.fusion.gated_pass import everything_believed
from navlearn.fusion.gating import Judged
from navlearn.fusion.innovation_likelihood import Foretold, LikelihoodOptions, foretold
from navlearn.fusion.noise import EkfNoise, log_noise, noise_from_log
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.recursion import predict_composed, run_loop
from navlearn.fusion.robust import weights
from navlearn.fusion.start import aligned_belief, told_from
from navlearn.fusion.timeline import Timeline, timeline
from navlearn.fusion.updates import measured
from navlearn.learning.spaced_fixes import spaced_fixes
from navlearn.mechanization.alignment import AlignmentOptions
from navlearn.mechanization.track_alignment import align_riss
from navlearn.states import FixTiming, GnssFix, RissSample

LEAST_FIXES = 30
"""Fewest fixes after alignment from which anything can be learned."""

LEAST_SPACED = 10
"""The same where fixes are some time apart and hardly share an error."""


class TuningDrive(NamedTuple):
    """A drive, or the stretch of one that a filter may be tuned on.

    Attributes:
        name: What it is called in messages.
        samples: Intervals, shape (T,) each.
        fixes: Its fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.
        lever_arm: Antenna from the point that navigates, body RFU, m; None for the filter's own.
        vertical_velocity: Whether its fixes tell how the car climbs; None for what the filter's
            options say.
    """

    name: str
    samples: RissSample
    fixes: GnssFix
    timing: FixTiming
    lever_arm: tuple[float, float, float] | None = None
    vertical_velocity: bool | None = None


def of_drive(options: EkfOptions, drive: TuningDrive) -> EkfOptions:
    """Return a filter's options with what belongs to a drive and not to the filter.

    Args:
        options: The filter.
        drive: Tells lever arm and vertical velocity.
    """
    arm, told = drive.lever_arm, drive.vertical_velocity
    return replace(
        options,
        lever_arm=options.lever_arm if arm is None else arm,
        vertical_velocity=options.vertical_velocity if told is None else told,
    )


class Held(NamedTuple):
    """What a filter's gate says of a drive, held, and where its blocks then start.

    Attributes:
        begin: Beliefs at which blocks start, batch shape (1, K).
        said: Verdicts and weights, shape (1, K, kinds).
    """

    begin: Belief
    said: Judged


class DriveLikelihood:
    """One drive behind one filter, whose noise is given anew every time.

    Attributes:
        name: The drive's name.
        model: The filter.
        start: Belief with which it starts, batch shape (1,).
        line: The drive in blocks from its alignment on.
        aligned: Time from the drive's beginning to its alignment, s.
        time: Time from the drive's beginning to the end of each block, s, shape (K,).
    """

    name: str
    model: FilterModel
    start: Belief
    line: Timeline
    aligned: float
    time: Tensor

    def __init__(
        self,
        drive: TuningDrive,
        options: EkfOptions,
        alignment: AlignmentOptions | None = None,
        spacing: float = 0.0,
        least: int | None = None,
    ) -> None:
        """Align and lay out a drive.

        Args:
            drive: The drive.
            options: The filter.
            alignment: How it is started, with all fixes; None means the defaults.
            spacing: The filter runs on fixes at least so far apart, s; 0 for all of them.
            least: Fewest fixes that are enough; None for what learning needs.

        Raises:
            LogError: The drive cannot be aligned, or has hardly any fix afterwards.
        """
        self.name, options = drive.name, of_drive(options, drive)
        try:
            aligned = align_riss(
                drive.samples, drive.fixes, drive.timing, alignment or AlignmentOptions()
            )
        except LogError as problem:
            raise LogError(f"{drive.name}: {problem}") from None
        first = aligned.sample + 1
        elapsed = torch.cumsum(drive.samples.dt, 0)
        later = FixTiming(
            torch.where(drive.timing.index >= first, drive.timing.index, -1), drive.timing.delay
        )
        fixes, timing = told_from(drive.fixes, spaced_fixes(later, elapsed, spacing), first)
        count = int((timing.index >= 0).sum())
        if least is None:
            least = LEAST_SPACED if spacing > 0.0 else LEAST_FIXES
        if count < least:
            raise LogError(_too_few(drive.name, count, least, spacing))
        samples = RissSample(*(channel[first:].unsqueeze(0) for channel in drive.samples))
        fixes, timing = GnssFix(*map(unsqueezed, fixes)), FixTiming(*map(unsqueezed, timing))
        self.model = filter_model(options)
        self.start = map_belief(aligned_belief(options, aligned), unsqueezed)
        check_inputs(self.model, self.start, samples, fixes, timing)
        self.line = timeline(self.model, samples, fixes, timing)
        self.aligned = float(elapsed[first - 1]) if first > 0 else 0.0
        self.time = elapsed[first + self.line.blocks.end[0]]

    @property
    def seconds(self) -> float:
        """Length from alignment to the last block's end, s."""
        return float(self.time[-1]) - self.aligned

    def judged(self, noise: EkfNoise, start: Belief | None = None) -> Held:
        """Run the filter with its own gate.

        Args:
            noise: Noise densities and deviations.
            start: Belief with which to start; None for the drive's own.

        Returns:
            The gate's verdicts, and where blocks start.

        Raises:
            FilterDivergedError: The run is not finite.
        """
        start = self.start if start is None else start
        with torch.no_grad():
            run = run_fast(self.model, start, self.line, noise)
            if run is None:
                run = run_loop(self.model, start, self.line, noise, predict_composed, "exact")
            begin = starts_of_blocks(start, run.belief)
        if not bool(torch.isfinite(run.belief.covariance).all()):
            raise FilterDivergedError(f"{self.name}: the filter's covariance is not finite")
        gate, rows = self.model.gate, self.model.rows
        weight = weights(gate, rows, run.nis, run.verdict)
        return Held(begin, Judged(run.nis, run.verdict, run.belief.refused, weight))

    def all_believed(self) -> Held:
        """Return verdicts that believe everything, and a first guess of where blocks start."""
        with torch.no_grad():
            begin = first_guess(self.model, self.start, self.line)
            noise = noise_from_log(log_noise(self.model.options.noise))
            found = measured(self.model.measurement, begin, self.line.occasion, noise)
        return Held(begin, everything_believed(self.model, found.present))

    def foretold(
        self,
        held: Held,
        noise: EkfNoise,
        start: Belief | None = None,
        options: LikelihoodOptions | None = None,
    ) -> Foretold:
        """Return the log-likelihood of the drive with verdicts given.

        Args:
            held: Verdicts, and where to begin from.
            noise: Noise densities and deviations.
            start: Belief with which to start; None for the drive's own.
            options: Which density.

        Raises:
            FilterDivergedError: The filter does not settle, or a figure is not finite.
        """
        start = self.start if start is None else start
        return foretold(self.model, start, self.line, noise, held.begin, held.said, options)


def _too_few(name: str, count: int, least: int, spacing: float) -> str:
    apart = f" {spacing:g} s apart" if spacing > 0.0 else ""
    closer = ", or take fixes that are closer together" if spacing > 0.0 else ""
    return (
        f"{name}: {count} fixes{apart} after alignment; tuning needs {least} or more: give it a "
        f"longer drive, or a longer part of this one{closer}"
    )


def by_window(
    time: Tensor, by_kind: Tensor, length: float, begin: float, least: float = 0.5
) -> tuple[Tensor, Tensor]:
    """Return log-likelihoods summed over windows of time.

    Args:
        time: Ends of blocks, s, shape (K,).
        by_kind: Log-likelihood, shape (1, K, kinds).
        length: Of a window, s.
        begin: Where the first one begins, s; blocks before it are left out.
        least: Share of a window that must be there for a last one to stand by itself; a shorter
            rest joins the one before.

    Returns:
        Sums, shape (W, kinds), and lengths, s, shape (W,).
    """
    kept = time > begin
    elapsed = time[kept] - begin
    if elapsed.numel() == 0:
        return by_kind.new_zeros((0, by_kind.shape[-1])), time.new_zeros(0)
    whole = float(elapsed[-1])
    count = max(int(whole / length + 1.0 - least), 1)
    index = (elapsed / length).long().clamp(max=count - 1)
    sums = by_kind.new_zeros((count, by_kind.shape[-1])).index_add(0, index, by_kind[0, kept])
    seconds = time.new_full((count,), length)
    seconds[-1] = whole - length * (count - 1)
    return sums, seconds
