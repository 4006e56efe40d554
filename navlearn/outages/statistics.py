"""What many outages say about a method: averages, and how sure its gain over a baseline is."""

import math
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
import pandas as pd
from scipy import stats

from navlearn.errors import ConfigError
from navlearn.outages.bootstrap import bootstrap_interval, improvement
from navlearn.outages.track import Array

HEADLINE = "max_horizontal_error_m"
HARM = 1.1
"""An outage counts as harm where the error is more than this many times the baseline's."""

FEWEST_UNITS = 6
"""With fewer drives (or outages of one drive) no verdict is given: even if all of them agreed,
a two-sided sign test could not reach 5 %."""

MARGIN_PERCENT = -3.0
"""A method whose whole interval lies above this improvement is harmless: by less the mean error
may grow before anybody notices. It is a third of what counts as harm in a single outage, and of
the ten metres that a good filter drifts in a minute it is less than a fix is off by."""


class Intervals(TypedDict, total=False):
    """How intervals are drawn: keywords of :func:`compare` and of all that stands on it."""

    confidence: float
    resamples: int
    seed: int


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One method against one baseline over the outages that both have.

    Attributes:
        pairs: Outages that both have.
        units: Drives (or outages) that the bootstrap drew from.
        drawn_by: ``drive`` or ``outage``.
        improvement_percent: 100 (1 − mean error / mean error of the baseline).
        low_percent: Lower end of the interval.
        high_percent: Upper end of the interval.
        wins: Outages in which the method is better.
        ties: Outages in which both are equal.
        win_rate_percent: Wins in percent of pairs.
        sign_test_p: Two-sided p of the sign test, ties left out.
        harm_count: Outages in which the method is more than 10 % worse, or failed where the
            baseline did not.
        failed: Of these, the failures.
        verdict: What the interval allows to say, as :func:`verdict_of`.
    """

    pairs: int
    units: int
    drawn_by: str
    improvement_percent: float
    low_percent: float
    high_percent: float
    wins: int
    ties: int
    win_rate_percent: float
    sign_test_p: float
    harm_count: int
    failed: int
    verdict: str


@dataclass(frozen=True, kw_only=True)
class Averages:
    """A figure of one method over its outages; failed ones have none.

    Attributes:
        outages: How many there are.
        failed: How many of them have no figure.
        mean: Mean.
        median: Median.
        p90: 90th percentile.
    """

    outages: int
    failed: int
    mean: float
    median: float
    p90: float


def averages(rows: pd.DataFrame, method: str, metric: str = HEADLINE) -> Averages:
    """Return mean, median and 90th percentile of a method's figure.

    Args:
        rows: Table of outages, as ``outages.csv``.
        method: Name of the method.
        metric: Column to average.

    Raises:
        ConfigError: The method or the metric is not in the table, or an outage comes twice.
    """
    errors = error_table(rows[rows["method"] == method], metric)
    if errors.empty:
        raise _no_method(rows, method)
    return averages_of(errors[method].to_numpy())


def averages_of(values: Array) -> Averages:
    """Return mean, median and 90th percentile of the figures of one method.

    Args:
        values: A figure per outage, NaN where the method failed, shape (N,).
    """
    known = values[np.isfinite(values)]
    if known.size:
        mean, (median, p90) = float(known.mean()), np.percentile(known, [50.0, 90.0])
    else:
        mean = median = p90 = math.nan
    return Averages(
        outages=values.size,
        failed=values.size - known.size,
        mean=mean,
        median=float(median),
        p90=float(p90),
    )


def compare(
    rows: pd.DataFrame,
    method: str,
    baseline: str,
    *,
    metric: str = HEADLINE,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> Comparison:
    """Compare a method with a baseline, outage by outage.

    Args:
        rows: Table with ``drive``, ``method``, ``outage`` and the metric, as ``outages.csv``.
        method: Name of the method.
        baseline: Name of the method to compare with.
        metric: Column to compare; smaller is better, never negative.
        confidence: Of the interval.
        resamples: Bootstrap draws.
        seed: Of the draws.

    Raises:
        ConfigError: A method or the metric is not in the table, or an outage comes twice.
    """
    errors = error_table(rows[rows["method"].isin((method, baseline))], metric)
    for name in (method, baseline):
        if name not in errors.columns:
            raise _no_method(rows, name)
    return compare_columns(
        errors, method, baseline, confidence=confidence, resamples=resamples, seed=seed
    )


def compare_columns(
    errors: pd.DataFrame,
    method: str,
    baseline: str,
    *,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> Comparison:
    """Compare two columns of a table of errors, as :func:`compare` does rows.

    Args:
        errors: What :func:`error_table` returned.
        method: A column.
        baseline: The column to compare with.
        confidence: Of the interval.
        resamples: Bootstrap draws.
        seed: Of the draws.
    """
    mine, other = errors[method].to_numpy(), errors[baseline].to_numpy()
    failed = int((np.isnan(mine) & ~np.isnan(other)).sum())
    both = ~np.isnan(mine + other)
    mine, other = mine[both], other[both]
    units, drawn_by = units_of(errors.index[both])
    low, high = bootstrap_interval(
        mine, other, units, confidence=confidence, resamples=resamples, seed=seed
    )
    wins, losses = int((mine < other).sum()), int((mine > other).sum())
    count = int(np.unique(units).size)
    return Comparison(
        pairs=mine.size,
        units=count,
        drawn_by=drawn_by,
        improvement_percent=improvement(mine, other),
        low_percent=low,
        high_percent=high,
        wins=wins,
        ties=mine.size - wins - losses,
        win_rate_percent=100.0 * wins / mine.size if mine.size else math.nan,
        sign_test_p=float(stats.binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0,
        harm_count=int((mine > HARM * other).sum()) + failed,
        failed=failed,
        verdict=verdict_of(low, high, count, failed),
    )


def error_table(rows: pd.DataFrame, metric: str = HEADLINE) -> pd.DataFrame:
    """Return the figure of every method side by side, a row per outage.

    Args:
        rows: Table of outages, as ``outages.csv``.
        metric: Column to judge by.

    Returns:
        A column per method, float64, NaN where it failed or was not run; indexed by drive and
        number of the outage.

    Raises:
        ConfigError: The metric is not in the table, or an outage comes twice.
    """
    if metric not in rows.columns:
        raise ConfigError(f"statistics: no column {metric!r}; there are {list(rows.columns)}")
    keys = ["drive", "outage", "method"]
    twice = rows.duplicated(keys)
    if twice.any():
        name = rows.loc[twice, "method"].iloc[0]
        raise ConfigError(f"statistics: {name} has an outage twice; give each drive its own name")
    # pivot_table would leave out the outages in which every method failed.
    return rows.set_index(keys)[metric].astype(float).unstack("method")  # noqa: PD010


def verdict_of(low: float, high: float, units: int, failed: int = 0) -> str:
    """Return what an interval allows to say.

    Args:
        low: Lower end of the improvement, %.
        high: Upper end, %.
        units: Drives or outages behind it.
        failed: Outages that only the baseline finished: the interval knows nothing of them.

    Returns:
        ``helps`` where the interval lies above zero and ``harms`` where it lies below, however
        little; else ``harmless`` where all of it lies above :data:`MARGIN_PERCENT`; else, and for
        fewer than :data:`FEWEST_UNITS`, ``no evidence``. With failures never ``helps`` or
        ``harmless``.
    """
    if units >= FEWEST_UNITS and high < 0.0:
        return "harms"
    if units >= FEWEST_UNITS and failed == 0 and low > 0.0:
        return "helps"
    if units >= FEWEST_UNITS and failed == 0 and low > MARGIN_PERCENT:
        return "harmless"
    return "no evidence"


def units_of(index: pd.Index) -> tuple[np.ndarray, str]:
    """Return what the bootstrap draws: drives where there are several, else outages.

    Args:
        index: Drive and number of each outage, as of :func:`error_table`.

    Returns:
        A name per outage, alike for what is drawn together, and ``drive`` or ``outage``.
    """
    drives = index.get_level_values("drive").to_numpy()
    if np.unique(drives).size > 1:
        return drives, "drive"
    return np.arange(len(index)), "outage"


def column(rows: pd.DataFrame, method: str, metric: str) -> "pd.Series[float]":
    """Return a method's figure, by drive and number of the outage.

    Args:
        rows: Table of outages, as ``outages.csv``.
        method: Name of the method.
        metric: Column.

    Raises:
        ConfigError: The method or the metric is not in the table, or an outage comes twice.
    """
    if metric not in rows.columns:
        raise ConfigError(f"statistics: no column {metric!r}; there are {list(rows.columns)}")
    part = rows[rows["method"] == method].set_index(["drive", "outage"])[metric]
    if part.empty:
        raise ConfigError(
            f"statistics: no method {method!r}; there are {list(rows['method'].unique())}"
        )
    if part.index.has_duplicates:
        raise ConfigError(f"statistics: {method} has an outage twice; give each drive its own name")
    return part.astype(float)


def _no_method(rows: pd.DataFrame, name: str) -> ConfigError:
    return ConfigError(f"statistics: no method {name!r}; there are {list(rows['method'].unique())}")
