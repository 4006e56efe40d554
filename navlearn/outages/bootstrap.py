"""The gain of a method over a baseline, and its interval.

The gain is a ratio of means, with a paired percentile bootstrap interval drawn by drive where
there are several, else by outage: outages of one drive are not independent. The percentiles are
taken further out for few units, [Hesterberg2015]: plain ones are too narrow there.

A draw is how often each unit was taken, so that the sums of all draws are one product of
matrices.
"""

import math
from functools import lru_cache

import numpy as np
from scipy import stats

from navlearn.outages.track import Array


def improvement(ours: Array, theirs: Array) -> float:
    """Return by how many percent the mean error is smaller than the baseline's.

    Args:
        ours: Errors of the method, shape (N,).
        theirs: Errors of the baseline in the same outages, shape (N,).
    """
    total = float(theirs.sum())
    return 100.0 * (1.0 - float(ours.sum()) / total) if total > 0.0 else math.nan


def bootstrap_interval(
    ours: Array,
    theirs: Array,
    units: np.ndarray,
    *,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> tuple[float, float]:
    """Return the percentile bootstrap interval of :func:`improvement`, drawn by unit.

    Args:
        ours: Errors of the method, shape (N,).
        theirs: Errors of the baseline in the same outages, shape (N,).
        units: What is drawn with all its outages together, shape (N,).
        confidence: Of the interval.
        resamples: Draws.
        seed: Of the draws.

    Returns:
        Lower and upper end, %; NaN where there is at most one unit to draw from.
    """
    count = np.unique(units).size
    if count < 2:
        return math.nan, math.nan
    sums = resampled_sums(np.stack([ours, theirs], axis=1), units, resamples=resamples, seed=seed)
    mine, other = sums[:, 0], sums[:, 1]
    if (other <= 0.0).any():
        return math.nan, math.nan
    tail = 100.0 * tail_probability(count, confidence)
    low, high = np.percentile(100.0 * (1.0 - mine / other), [tail, 100.0 - tail])
    return float(low), float(high)


def resampled_sums(
    values: Array, units: np.ndarray, *, resamples: int = 5000, seed: int = 0
) -> Array:
    """Return the sums of columns in each bootstrap draw, every column from the same draws.

    Args:
        values: Columns of figures, shape (N, M).
        units: What is drawn with all its rows together, shape (N,).
        resamples: Draws.
        seed: Of the draws.

    Returns:
        Sums, shape (resamples, M).
    """
    names, member = np.unique(units, return_inverse=True)
    sums = np.stack(
        [np.bincount(member, weights=column, minlength=names.size) for column in values.T], axis=1
    )
    return np.asarray(_draws(names.size, resamples, seed) @ sums, dtype=np.float64)


def tail_probability(units: int, confidence: float = 0.95) -> float:
    """Return the share of bootstrap draws to leave out at either end.

    [Hesterberg2015], the expanded percentile interval: for a mean of normal values it is
    as wide as Student's interval.

    Args:
        units: How many units are drawn from.
        confidence: Of the interval.
    """
    if units < 2:
        return 0.0
    student = stats.t.ppf(0.5 * (1.0 - confidence), units - 1)
    return float(stats.norm.cdf(math.sqrt(units / (units - 1)) * student))


@lru_cache(maxsize=2)
def _draws(units: int, resamples: int, seed: int) -> Array:
    """Return how often each unit was taken in each draw, shape (resamples, units)."""
    picks = np.random.default_rng(seed).integers(units, size=(resamples, units))
    flat = picks + units * np.arange(resamples)[:, None]
    taken = np.bincount(flat.ravel(), minlength=units * resamples).astype(np.float64)
    taken.flags.writeable = False  # it is shared by all who ask for the same draws
    return taken.reshape(resamples, units)
