"""Tables of the degree of observability: extreme directions by phase, and every state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch

from navlearn.filters.degree_of_observability import direction_in_words
from navlearn.outages.observability_record import ObservabilityRecord, spoken
from navlearn.outages.schedule import Outage
from navlearn.outages.track import Array

MOST_PHASES = 8
"""So many outages are shown in the report's table, spread over the drive."""

LONG_STANDSTILL = 10.0
"""The longest standstill is shown if it lasts so long, s."""


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A stretch of a drive whose beginning, middle and end are looked at.

    Attributes:
        name: What it is.
        start: When it begins, s.
        end: When it ends, s.
    """

    name: str
    start: float
    end: float


def phases(record: ObservabilityRecord, outages: Sequence[Outage]) -> list[Phase]:
    """Return what to look at: the longest standstill, the outages, the end of the drive.

    Args:
        record: The record.
        outages: The outages; of more than :data:`MOST_PHASES` some spread over the drive.
    """
    free = [
        one for one in record.standstills() if not any(_overlap(one, outage) for outage in outages)
    ]
    longest = max(free, key=lambda one: one[1] - one[0], default=(0.0, 0.0))
    found: list[Phase] = []
    if longest[1] - longest[0] >= LONG_STANDSTILL:
        found.append(Phase(name="longest standstill", start=longest[0], end=longest[1]))
    count = len(outages)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_PHASES)).round().astype(int))
    for k in chosen.tolist() if count else []:
        outage = outages[k]
        found.append(Phase(name=f"outage {k + 1}", start=outage.start, end=outage.end))
    end = float(record.t[-1])
    return [*found, Phase(name="drive", start=end, end=end)]


def direction_table(record: ObservabilityRecord, looked_at: Sequence[Phase]) -> pd.DataFrame:
    """Return the best and the least observed direction at start, middle and end of phases.

    The end is that before whatever ends the phase, such as the first fix after an outage.

    Args:
        record: The record.
        looked_at: The phases; one without length is looked at once.

    Returns:
        A row per moment: ``phase``, ``moment``, ``t``, and of the ``best`` and the ``least``
        direction ``_left`` (deviation against the start), ``_share`` (eigenvalue of P'') and
        ``_direction`` (in words; empty where all directions are alike, as at the start).
    """
    rows = []
    for phase in looked_at:
        moments = {"end": record.row_at(phase.end)}
        if phase.end > phase.start:
            middle = 0.5 * (phase.start + phase.end)
            moments = {
                "start": record.row_at(phase.start),
                "middle": record.row_at(middle),
                "end": record.row_before(phase.end),
            }
        for moment, k in moments.items():
            row: dict[str, object] = {"phase": phase.name, "moment": moment, "t": record.t[k]}
            for kind, place, vectors in (("best", 0, record.best), ("least", -1, record.least)):
                value = record.eigenvalues[k, place]
                row[f"{kind}_left"] = float(np.sqrt(value))
                row[f"{kind}_share"] = float(value * record.to_share[k, 0])
                row[f"{kind}_direction"] = _in_words(record, k, vectors[k])
            rows.append(row)
    return pd.DataFrame(rows)


def state_table(record: ObservabilityRecord, outages: Sequence[Outage]) -> pd.DataFrame:
    """Return what is left of every state's deviation.

    Args:
        record: The record.
        outages: The outages.

    Returns:
        A row per state: ``state``, ``unit``, ``initial``; deviations against it: ``least`` ever,
        at ``outages_start`` and ``outages_end``, ``last``; and through outages by how much the
        deviation grows, ``growth``, and its part in P'', ``share_growth``. What is of outages is
        the median over them, NaN where there are none.
    """
    diagonal = record.against_start
    left, share = np.sqrt(diagonal), record.to_share * diagonal
    starts = [record.row_at(one.start) for one in outages]
    ends = [record.row_before(one.end) for one in outages]

    def middle(of_outages: Array) -> Array:
        if not outages:
            return np.full(len(record.names), np.nan)
        return np.asarray(np.median(of_outages, 0), dtype=np.float64)

    return pd.DataFrame(
        {
            "state": [spoken(name) for name in record.names],
            "unit": [record.units.get(name, "") for name in record.names],
            "initial": record.sigma[0],
            "least": left.min(0),
            "outages_start": middle(left[starts]),
            "outages_end": middle(left[ends]),
            "last": left[-1],
            "growth": middle(left[ends] / left[starts]),
            "share_growth": middle(share[ends] / share[starts]),
        }
    )


def _in_words(record: ObservabilityRecord, k: int, direction: Array) -> str:
    values = record.eigenvalues[k]
    if values[-1] <= values[0] * (1.0 + 1e-9):
        return ""
    return direction_in_words(torch.from_numpy(direction.copy()), record.names)


def _overlap(span: tuple[float, float], outage: Outage) -> bool:
    return span[0] < outage.end and outage.start < span[1]
