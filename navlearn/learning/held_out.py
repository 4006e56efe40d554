"""Tuned against untuned on data that the tuning has not seen.

Both filters run causally through the whole drive, each with its own gate; what is compared is the
log-likelihood of the same measurements in the same stretches of time, so that nothing but the
noise differs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from navlearn.errors import LogError
from navlearn.fusion.innovation_likelihood import LikelihoodOptions
from navlearn.fusion.noise import log_noise, noise_from_log
from navlearn.fusion.options import EkfOptions
from navlearn.learning.drive_likelihood import DriveLikelihood, TuningDrive, by_window
from navlearn.mechanization.alignment import AlignmentOptions


@dataclass(frozen=True, kw_only=True)
class HeldOutStretch:
    """A drive of which a part was not tuned on.

    Attributes:
        drive: The whole drive, as a filter runs through it.
        after: Time from its beginning from which on it is judged, s.
    """

    drive: TuningDrive
    after: float = 0.0


@dataclass(frozen=True, kw_only=True)
class HeldOutScores:
    """Log-likelihoods of held-out windows of time, by two filters.

    Attributes:
        before: Of the untuned filter, nats, shape (W,).
        after: Of the tuned filter, nats, shape (W,).
        seconds: Lengths of the windows, s, shape (W,).
    """

    before: Tensor
    after: Tensor
    seconds: Tensor


def held_out_scores(
    stretches: Sequence[HeldOutStretch],
    before: EkfOptions,
    after: EkfOptions,
    *,
    window: float = 60.0,
    likelihood: LikelihoodOptions | None = None,
    alignment: AlignmentOptions | None = None,
    spacing: float = 0.0,
) -> HeldOutScores:
    """Return what two filters foretell of held-out stretches.

    Args:
        stretches: Drives, and from where on they are judged.
        before: The untuned filter.
        after: The tuned filter.
        window: Length of the windows, s.
        likelihood: How innovations are judged; None means the defaults.
        alignment: How the filters are started; None means the defaults.
        spacing: Both filters run on fixes at least so far apart, s; 0 for all of them.

    Raises:
        LogError: A drive cannot be aligned, or nothing of it is left to be judged.
        FilterDivergedError: A filter is lost.
    """
    parts = []
    for stretch in stretches:
        old, seconds = _windows(stretch, before, window, likelihood, alignment, spacing)
        new, _ = _windows(stretch, after, window, likelihood, alignment, spacing)
        parts.append((old, new, seconds))
    columns = [torch.cat(column) for column in zip(*parts, strict=True)]
    return HeldOutScores(before=columns[0], after=columns[1], seconds=columns[2])


def _windows(
    stretch: HeldOutStretch,
    options: EkfOptions,
    window: float,
    likelihood: LikelihoodOptions | None,
    alignment: AlignmentOptions | None,
    spacing: float,
) -> tuple[Tensor, Tensor]:
    own = DriveLikelihood(stretch.drive, options, alignment, spacing, least=1)
    noise = noise_from_log(log_noise(options.noise))
    with torch.no_grad():
        found = own.foretold(own.judged(noise), noise, None, likelihood)
    begin = max(stretch.after, own.aligned)
    sums, seconds = by_window(own.time, found.log_likelihood, window, begin)
    if len(seconds) == 0:
        raise LogError(
            f"{own.name}: nothing is left after {begin:.0f} s to judge what was tuned; hold out a "
            "larger share"
        )
    return sums.sum(-1), seconds
