"""Every range of a satellite that a tightly coupled filter refused over a drive, as a table."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from navlearn.fusion.measurements import Verdict
from navlearn.outages.refused_fixes import TOLD, counts_of
from navlearn.outages.track import Array

_KINDS: Final = (("pseudorange", "m"), ("range_rate", "m/s"))


@dataclass(frozen=True, kw_only=True, eq=False)
class RangeJudgements:
    """What a filter made of ranges over a drive: K moments, S satellites.

    Attributes:
        t: Times of reception, s, shape (K,).
        satellites: Names of the satellites, in the order of their slots.
        innovation: Measured minus predicted of pseudoranges (m), then of range rates (m/s), NaN
            where there is none, shape (K, 2 S).
        nis: Normalised innovation squared in the same order.
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict` in the same order.
        nis_limit: Largest NIS that passes.
    """

    t: Array
    satellites: tuple[str, ...]
    innovation: Array
    nis: Array
    verdict: np.ndarray
    nis_limit: float


def refused_ranges_table(found: RangeJudgements) -> pd.DataFrame:
    """Return the ranges that were refused, or taken because position or clock began anew.

    Args:
        found: What a filter made of ranges.

    Returns:
        A row per range, in order of time: ``t`` (s), ``satellite``, ``kind``, ``verdict``,
        ``innovation`` in ``unit``, ``nis``, ``nis_limit``.
    """
    moment, place = np.nonzero(np.isin(found.verdict, TOLD))
    slots = len(found.satellites)
    kind = place // slots
    return pd.DataFrame(
        {
            "t": found.t[moment],
            "satellite": [found.satellites[one] for one in place % slots],
            "kind": [_KINDS[one][0] for one in kind],
            "verdict": [Verdict(one).name.lower() for one in found.verdict[moment, place]],
            "innovation": found.innovation[moment, place],
            "unit": [_KINDS[one][1] for one in kind],
            "nis": found.nis[moment, place],
            "nis_limit": found.nis_limit,
        }
    )


def range_counts(found: RangeJudgements) -> pd.DataFrame:
    """Return how often pseudoranges and range rates got each verdict over a drive.

    Args:
        found: What a filter made of ranges.

    Returns:
        Rows like those of :func:`navlearn.outages.refused_fixes.verdict_counts`.
    """
    slots = len(found.satellites)
    halves = found.verdict[:, :slots], found.verdict[:, slots:]
    rows = [counts_of(kind, half) for (kind, _), half in zip(_KINDS, halves, strict=True)]
    return pd.DataFrame([row for row in rows if row["measured"]])
