"""The tightly coupled filter as a method: what is still heard of satellites goes on helping."""

import numpy as np
import pandas as pd
import torch

from navlearn.experiment.solution_tables import (
    ins_solution_table,
    solution_table,
    with_deviations,
)
from navlearn.experiment.tight_filter_runs import TightFilterRuns, TightStart
from navlearn.fusion.measurements import believed, refused
from navlearn.fusion.tight.history import TightHistory
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.states import InsState


class TightMethod:
    """The filter through the outage, with the ranges of the satellites that stay."""

    def __init__(self, runs: TightFilterRuns, method: str = "tc_ekf") -> None:
        """Make the method.

        Args:
            runs: Filter runs, shared with the other methods.
            method: Which filter: ``tc_ekf`` or ``tc_ukf``.
        """
        self.runs, self.method = runs, method

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the filter's solution through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start, and from there
                without ranges but those of the satellites that stay visible.
            outage: The outage.
        """
        start = self.runs.before(log, outage, self.method)
        history = start.through()
        notes = {"filter": history.method, **heard(start, history)}
        return Solution(table=tight_table(start, history, outage), notes=notes)


def tight_table(start: TightStart, history: TightHistory, outage: Outage) -> pd.DataFrame:
    """Return a tightly coupled solution through an outage as a table, with its deviations.

    Args:
        start: What came before the outage.
        history: The filter's run from its start on.
        outage: The outage.
    """
    before, after = start.run.history, history
    t = torch.cat((start.line.t[start.run.first : len(start.line.t) - len(start.t)], start.t))
    first, second = before.trajectory, after.trajectory
    path = type(first)(*(torch.cat(pair, 0) for pair in zip(first, second, strict=True)))
    table = (
        ins_solution_table(t, path, outage)
        if isinstance(path, InsState)
        else solution_table(t, path, outage)
    )
    ends = torch.cat((before.end, after.end + len(before.trajectory.lat)))
    covariance = torch.cat((before.belief.covariance, after.belief.covariance))
    return with_deviations(table, t[ends], covariance[..., :2, :2])


def heard(start: TightStart, history: TightHistory) -> dict[str, object]:
    """Return what a filter made of the ranges in an outage, as notes.

    Args:
        start: What came before the outage.
        history: The filter's run from its start on.
    """
    slots = len(start.series.satellites)
    verdict = history.verdict[:, :slots]
    fine = believed(verdict).numpy()
    names = [start.series.satellites[slot] for slot in np.flatnonzero(fine.any(0))]
    return {
        "satellites_used": " ".join(names),
        "ranges_used": int(fine.sum()),
        "ranges_refused": int(refused(verdict).sum()),
    }
