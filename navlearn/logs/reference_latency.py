"""Taking known latencies off a reference: one for its poses, one for its velocities.

An integrated instrument may extrapolate its pose to the time it speaks while its velocities and
sensors are a filter's delay behind: then one table has two clocks.
"""

from typing import Final

import numpy as np
import pandas as pd

from navlearn.logs.quality.signals import curve_through
from navlearn.logs.table_layout import ReferenceLatency

_VELOCITIES: Final = ("v_e", "v_n", "v_u")
_LONGEST: Final = 2.5


def without_reference_latency(reference: pd.DataFrame, latency: ReferenceLatency) -> pd.DataFrame:
    """Return a reference whose poses and velocities hold at the times of its rows.

    The rows' times are moved, so that no pose is interpolated; velocities that are stamped
    otherwise are interpolated to them, and NaN at the ends and in gaps.

    Args:
        reference: Reference with increasing times.
        latency: How late poses and velocities are stamped.
    """
    stamped = reference["t"].to_numpy(np.float64)
    moved = reference.assign(t=stamped - latency.pose)
    if latency.pose == latency.velocity or stamped.size < 2:
        return moved
    longest = _LONGEST * float(np.median(np.diff(stamped)))
    for name in (name for name in _VELOCITIES if name in reference):
        values = reference[name].to_numpy(np.float64)
        known = np.isfinite(values)
        through = curve_through(stamped[known] - latency.velocity, values[known], longest=longest)
        moved[name] = through(moved["t"].to_numpy(np.float64))
    return moved
