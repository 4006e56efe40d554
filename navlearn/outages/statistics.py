"""What many outages say about a method: averages, and how sure its gain over a baseline is."""

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from navlearn.errors import ConfigError
from navlearn.outages.bootstrap import bootstrap_interval, improvement

HEADLINE = "max_horizontal_error_m"
HARM = 1.1
"""An outage counts as harm where the error is more than this many times the baseline's."""

FEWEST_UNITS = 6
"""With fewer drives (or outages of one drive) no verdict is given: even if all of them agreed,
a two-sided sign test could not reach 5 %."""


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
        verdict: ``helps`` or ``harms`` where the interval excludes zero, else ``no evidence``;
            never ``helps`` where the method failed and the baseline did not.
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
    values = _column(rows, method, metric).to_numpy()
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
    ours, theirs = _column(rows, method, metric), _column(rows, baseline, metric)
    both = pd.DataFrame({"ours": ours, "theirs": theirs})
    failed = int((both["ours"].isna() & both["theirs"].notna()).sum())
    both = both.dropna()
    mine, other = both["ours"].to_numpy(), both["theirs"].to_numpy()
    drives = both.index.get_level_values("drive").to_numpy()
    several = np.unique(drives).size > 1
    units = drives if several else np.arange(mine.size)
    low, high = bootstrap_interval(
        mine, other, units, confidence=confidence, resamples=resamples, seed=seed
    )
    wins, losses = int((mine < other).sum()), int((mine > other).sum())
    count = int(np.unique(units).size)
    return Comparison(
        pairs=mine.size,
        units=count,
        drawn_by="drive" if several else "outage",
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


def verdict_of(low: float, high: float, units: int, failed: int = 0) -> str:
    """Return what an interval allows to say.

    Args:
        low: Lower end of the improvement, %.
        high: Upper end, %.
        units: Drives or outages behind it.
        failed: Outages that only the baseline finished: the interval knows nothing of them.
    """
    if units >= FEWEST_UNITS and low > 0.0 and failed == 0:
        return "helps"
    if units >= FEWEST_UNITS and high < 0.0:
        return "harms"
    return "no evidence"


def method_table(
    rows: pd.DataFrame,
    *,
    baselines: tuple[str, ...] = ("ekf", "ekf_plain"),
    metric: str = HEADLINE,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return one row per method: averages, and its comparison with every baseline.

    Args:
        rows: Table of outages, as ``outages.csv``.
        baselines: Methods to compare with; those not in the table are left out.
        metric: Column to judge by.
        confidence: Of the intervals.
        resamples: Bootstrap draws.
        seed: Of the draws.

    Returns:
        ``method``, ``outages``, ``failed``, ``mean``, ``median``, ``p90``; then per baseline
        the fields of :class:`Comparison`, each followed by ``_vs_`` and the baseline's name;
        empty (NaN) where a method would be compared with itself.

    Raises:
        ConfigError: The metric is not in the table, or an outage comes twice.
    """
    present = [name for name in baselines if (rows["method"] == name).any()]
    table = []
    for method in rows["method"].unique():
        line: dict[str, object] = {"method": method, **vars(averages(rows, method, metric))}
        for baseline in present:
            if method != baseline:
                found = compare(
                    rows,
                    method,
                    baseline,
                    metric=metric,
                    confidence=confidence,
                    resamples=resamples,
                    seed=seed,
                )
                line |= {f"{key}_vs_{baseline}": value for key, value in vars(found).items()}
        table.append(line)
    return pd.DataFrame(table)


def _column(rows: pd.DataFrame, method: str, metric: str) -> "pd.Series[float]":
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
