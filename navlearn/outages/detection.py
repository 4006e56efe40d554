"""How many faults a filter catches, and how many good fixes it takes for faults.

A position fix is caught where it is refused, or taken with less than half its weight: then its
variance is more than doubled, and it moves the filter less than half as far as it would.
Intervals are those of Wilson for a share, [Wilson1927]; fixes of one stretch are not independent,
so that intervals of long faults are too narrow unless faults are counted instead.
"""

import math
from typing import Final

import numpy as np
import pandas as pd

from navlearn.fusion.measurements import Verdict
from navlearn.outages.refused_fixes import REFUSED, Judgements, fault_at

CAUGHT: Final = (*REFUSED, Verdict.ACCEPTED_WITH_LESS_WEIGHT)
"""Verdicts of a fix that did nothing, or less than half of what it would have."""

GOOD: Final = "none (good)"
"""What fixes without a fault are called."""

STANDARD_NORMAL_95: Final = 1.959964


def wilson_interval(hits: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share.

    [Wilson1927], as recommended for small counts: never outside [0, 1], and not empty where all
    or none hit.

    Args:
        hits: How many hit.
        trials: How many there were.

    Returns:
        Its ends; NaN without trials.
    """
    if trials == 0:
        return math.nan, math.nan
    z2 = STANDARD_NORMAL_95**2
    share = hits / trials
    middle = (share + 0.5 * z2 / trials) / (1.0 + z2 / trials)
    half = math.sqrt(z2 * share * (1.0 - share) / trials + 0.25 * (z2 / trials) ** 2)
    half /= 1.0 + z2 / trials
    return max(0.0, middle - half), min(1.0, middle + half)


def position_verdicts(judgements: Judgements, faults: pd.DataFrame | None) -> pd.DataFrame:
    """Return what became of every position fix.

    Args:
        judgements: What a filter made of its measurements.
        faults: What :func:`navlearn.logs.synthetic.faults.injected_faults` returns.

    Returns:
        A row per fix: ``t`` (s), ``verdict`` (code), ``caught``, ``weight``, ``innovation``
        (horizontal, m), ``nis`` and ``fault``, its number, 0 for none.
    """
    index = judgements.kinds.index("position")
    at = np.flatnonzero(judgements.verdict[:, index] != int(Verdict.ABSENT))
    verdict = judgements.verdict[at, index]
    first = judgements.rows.of(next(k for k in judgements.rows.kinds if int(k) == index))
    horizontal = judgements.innovation[at, first][:, :2]
    return pd.DataFrame(
        {
            "t": judgements.t[at],
            "verdict": verdict,
            "caught": np.isin(verdict, CAUGHT),
            "weight": judgements.weight[at, index],
            "innovation": np.hypot(horizontal[:, 0], horizontal[:, 1]),
            "nis": judgements.nis[at, index],
            "fault": fault_at(judgements.t[at], faults),
        }
    )


def detection_by_kind(judgements: Judgements, faults: pd.DataFrame) -> pd.DataFrame:
    """Return the share of position fixes that was caught, by kind of fault.

    Args:
        judgements: What a filter made of its measurements.
        faults: The faults.

    Returns:
        A row per kind, good fixes last: ``kind``, ``fixes``, ``caught``, ``share``, ``low`` and
        ``high``.
    """
    fixes = position_verdicts(judgements, faults)
    kinds = dict(zip(faults["fault"], faults["kind"], strict=True))
    named = fixes["fault"].map(lambda one: kinds.get(one, GOOD))
    return pd.DataFrame(
        [
            share_row(kind, fixes.loc[named == kind, "caught"])
            for kind in (*sorted(set(named) - {GOOD}), GOOD)
        ]
    )


def share_row(kind: str, caught: "pd.Series[bool]") -> dict[str, object]:
    """Return how many of some fixes or faults were caught, with the interval of the share.

    Args:
        kind: What they are.
        caught: Whether each was.
    """
    hits, trials = int(caught.sum()), len(caught)
    low, high = wilson_interval(hits, trials)
    share = hits / trials if trials else math.nan
    row = {"kind": kind, "fixes": trials, "caught": hits, "share": share}
    return {**row, "low": low, "high": high}
