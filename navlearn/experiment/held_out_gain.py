"""By how much a tuned filter foretells held-out data better, with an interval."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from navlearn.learning.held_out import HeldOutScores
from navlearn.outages.bootstrap import resampled_sums, tail_probability

FEW = 5
"""With fewer windows draws of them show too little; Student's interval of their gains does."""


@dataclass(frozen=True, kw_only=True)
class HeldOutGain:
    """Log-likelihood per second of held-out data, tuned against untuned.

    Attributes:
        before: Untuned, nats per second.
        after: Tuned, nats per second.
        low: Lower end of the interval of 95 % of their difference.
        high: Upper end.
        windows: How many windows were drawn from.
        seconds: Length of the held-out data, s.
    """

    before: float
    after: float
    low: float
    high: float
    windows: int
    seconds: float

    @property
    def gain(self) -> float:
        """Tuned minus untuned, nats per second."""
        return self.after - self.before

    @property
    def better(self) -> bool:
        """Whether the tuned filter is clearly the likelier one."""
        return self.low > 0.0

    @property
    def words(self) -> str:
        """The figures in words."""
        return (
            f"held-out log-likelihood {self.before:.3f} -> {self.after:.3f} nats/s, "
            f"{self.gain:+.3f} ({self.low:+.3f} to {self.high:+.3f}, 95 %, {self.windows} windows)"
        )


def held_out_gain(scores: HeldOutScores, *, seed: int = 0) -> HeldOutGain:
    """Return the gain with an interval: bootstrap draws of windows, Student's where they are few.

    Args:
        scores: What both filters foretold.
        seed: Of the draws.
    """
    old, new, seconds = (values.numpy() for values in (scores.before, scores.after, scores.seconds))
    total, count = float(seconds.sum()), len(seconds)
    low = high = math.nan
    if 2 <= count < FEW:
        low, high = _students(new - old, seconds)
    elif count >= FEW:
        columns = np.stack([new - old, seconds], axis=1)
        sums = resampled_sums(columns, np.arange(count), seed=seed)
        tail = 100.0 * tail_probability(count)
        ends = np.percentile(sums[:, 0] / sums[:, 1], [tail, 100.0 - tail])
        low, high = float(ends[0]), float(ends[1])
    return HeldOutGain(
        before=float(old.sum()) / total,
        after=float(new.sum()) / total,
        low=low,
        high=high,
        windows=count,
        seconds=total,
    )


def _students(gains: np.ndarray, seconds: np.ndarray) -> tuple[float, float]:
    """Return the interval of 95 % of gains per second over a few windows."""
    count, ratio = len(gains), float(gains.sum() / seconds.sum())
    rest = gains - ratio * seconds
    error = math.sqrt(float(rest @ rest) / (count * (count - 1))) / float(seconds.mean())
    half = float(stats.t.ppf(0.975, count - 1)) * error
    return ratio - half, ratio + half
