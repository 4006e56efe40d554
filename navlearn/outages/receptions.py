"""Which satellites a log received at which moments: what placement may look at of raw ranges."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from navlearn.outages.track import Array

GOOD_SATELLITES = 4
"""With so many satellites a reception is as good as a fix: it gives a position and the clock."""


@dataclass(frozen=True, kw_only=True)
class Receptions:
    """The R receptions of a log to S satellites.

    Attributes:
        t: Times, s, increasing, shape (R,).
        names: Names of the satellites, sorted.
        received: Whether each was received, shape (R, S).
    """

    t: Array
    names: tuple[str, ...]
    received: NDArray[np.bool_]

    def before(self, time: float) -> int | None:
        """Return the last reception before a time, or None.

        Args:
            time: Time, s.
        """
        found = int(np.searchsorted(self.t, time, side="left")) - 1
        return found if found >= 0 else None

    def share(self, start: float, end: float) -> Array:
        """Return among which share of the receptions of a stretch each satellite is.

        Receptions that are missing altogether count: there should be one every median interval.

        Args:
            start: First time, s.
            end: Last time, s.

        Returns:
            Shares, shape (S,).
        """
        within = self.received[(self.t >= start) & (self.t <= end)]
        usual = float(np.median(np.diff(self.t))) if self.t.size > 1 else end - start
        should_be = max(len(within), (end - start) / usual, 1.0)
        return np.asarray(within.sum(axis=0) / should_be, dtype=np.float64)

    def good_times(self, satellites: int = GOOD_SATELLITES) -> Array:
        """Return the times of receptions of at least so many satellites, s.

        Args:
            satellites: How many.
        """
        good = self.received.sum(axis=1) >= satellites
        return np.asarray(self.t[good], dtype=np.float64)


def receptions_of(ranges: pd.DataFrame) -> Receptions:
    """Return which satellites were received at which moments.

    Args:
        ranges: A log's table of raw ranges.
    """
    t, moment = np.unique(ranges["t"].to_numpy(dtype=np.float64), return_inverse=True)
    names, satellite = np.unique(ranges["satellite"].to_numpy(dtype=str), return_inverse=True)
    received = np.zeros((t.size, names.size), dtype=np.bool_)
    received[moment, satellite] = True
    return Receptions(t=t, names=tuple(str(name) for name in names), received=received)
