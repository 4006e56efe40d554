"""What share of the oracle's gain a method reached: its real score in simulation.

Of the gap between the baseline and what no method can pass, the share that a method closed. A
ratio of two differences, so it means nothing where the oracle's own gain is not clear of zero.
"""

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from navlearn.outages.bootstrap import resampled_sums, tail_probability
from navlearn.outages.roles import ORACLE
from navlearn.outages.statistics import (
    FEWEST_UNITS,
    HEADLINE,
    compare_columns,
    error_table,
    units_of,
)
from navlearn.outages.track import Array


@dataclass(frozen=True, kw_only=True)
class OracleShare:
    """The share of the oracle's gain that a method reached.

    Attributes:
        share_percent: 100 (baseline − method) / (baseline − oracle), of mean errors; NaN where
            it is not known.
        low_percent: Lower end of its interval.
        high_percent: Upper end of its interval.
        outages: Outages that baseline, method and oracle all finished.
        unknown_because: Why there is no share; empty where there is one.
    """

    share_percent: float
    low_percent: float
    high_percent: float
    outages: int
    unknown_because: str = ""


def share_of_oracle(
    rows: pd.DataFrame,
    method: str,
    baseline: str = "ekf",
    *,
    metric: str = HEADLINE,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> OracleShare:
    """Return the share of the oracle's gain over a baseline that a method reached.

    Args:
        rows: Table of outages, as ``outages.csv``.
        method: Name of the method.
        baseline: Where the gain is counted from.
        metric: Column to judge by; smaller is better, never negative.
        confidence: Of the interval.
        resamples: Bootstrap draws.
        seed: Of the draws.

    Raises:
        ConfigError: The metric is not in the table, or an outage comes twice.
    """
    errors = error_table(rows[rows["method"].isin((method, baseline, ORACLE))], metric)
    return share_of_columns(
        errors, method, baseline, confidence=confidence, resamples=resamples, seed=seed
    )


def share_of_columns(
    errors: pd.DataFrame,
    method: str,
    baseline: str = "ekf",
    *,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> OracleShare:
    """Return the share of a column of a table of errors, as :func:`share_of_oracle` of rows.

    Args:
        errors: What :func:`~navlearn.outages.statistics.error_table` returned.
        method: A column.
        baseline: The column where the gain is counted from.
        confidence: Of the interval.
        resamples: Bootstrap draws.
        seed: Of the draws.
    """
    for name in (ORACLE, baseline, method):
        if name not in errors.columns:
            return _unknown(0, f"there is no `{name}` to measure by")
    values = errors[[baseline, method, ORACLE]].dropna()
    limit = compare_columns(
        errors, ORACLE, baseline, confidence=confidence, resamples=resamples, seed=seed
    )
    if limit.verdict != "helps" or values.empty:
        return _unknown(len(values), why_no_share(limit.units, limit.failed))
    figures = values.to_numpy()
    units, _ = units_of(values.index)
    gains = _gains(figures.sum(axis=0, keepdims=True))[0]
    sums = resampled_sums(figures, units, resamples=resamples, seed=seed)
    tail = tail_probability(np.unique(units).size, confidence)
    low, high = _ends(_gains(sums), tail)
    return OracleShare(
        share_percent=100.0 * float(gains[0] / gains[1]) if gains[1] > 0.0 else math.nan,
        low_percent=low,
        high_percent=high,
        outages=len(values),
    )


def why_no_share(units: int, failed: int) -> str:
    """Return why an oracle that was run is not known to help, so that there is no share.

    Args:
        units: Drives (or outages of one drive) on which it was compared with the baseline.
        failed: Outages that only the baseline finished.
    """
    if units < FEWEST_UNITS:
        return f"the oracle's own gain rests on fewer than {FEWEST_UNITS} drives or outages"
    if failed:
        return "the oracle failed where the baseline did not"
    return "the oracle's own gain is not clear of zero"


def share_columns(share: OracleShare) -> dict[str, object]:
    """Return a share as columns of a table.

    Args:
        share: The share.

    Returns:
        ``oracle_share_percent``, ``oracle_share_low_percent``, ``oracle_share_high_percent`` and
        ``oracle_share_unknown_because``.
    """
    return {
        "oracle_share_percent": share.share_percent,
        "oracle_share_low_percent": share.low_percent,
        "oracle_share_high_percent": share.high_percent,
        "oracle_share_unknown_because": share.unknown_because,
    }


def _gains(sums: Array) -> Array:
    """Return what method and oracle gain, from sums of baseline, method, oracle, shape (..., 3)."""
    return np.asarray(sums[:, :1] - sums[:, 1:])


def _ends(gains: Array, tail: float) -> tuple[float, float]:
    """Return the ends of the share's interval, %, from both gains in every draw.

    A draw in which the oracle gains nothing could stand for any share: it counts as worse than
    all others at the lower end and as better than all others at the upper one.
    """
    mine, limit = gains.T
    sound = limit > 0.0
    share = 100.0 * mine / np.where(sound, limit, 1.0)
    left_out = int(tail * share.size)
    low = np.sort(np.where(sound, share, -math.inf))[left_out]
    high = np.sort(np.where(sound, share, math.inf))[-1 - left_out]
    return tuple(float(end) if math.isfinite(end) else math.nan for end in (low, high))  # type: ignore[return-value]


def _unknown(outages: int, why: str) -> OracleShare:
    return OracleShare(
        share_percent=math.nan,
        low_percent=math.nan,
        high_percent=math.nan,
        outages=outages,
        unknown_because=why,
    )
