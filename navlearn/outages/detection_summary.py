"""False alarms and position errors of several drives together, with intervals."""

import math

import numpy as np
import pandas as pd

from navlearn.outages.bootstrap import resampled_sums, tail_probability


def rms_by_drive(drives: pd.DataFrame, *, resamples: int = 5000) -> dict[str, object]:
    """Return what several drives tell together, with intervals drawn by drive.

    Args:
        drives: A row per drive: ``alarms`` of ``good`` fixes; ``squares`` (m²) of position errors
            at ``times``; ``near_squares`` at the ``near`` times; ``worst`` error, m.
        resamples: Bootstrap draws.

    Returns:
        ``false alarms %``, ``RMS m``, ``RMS near m`` with their 95 % intervals, in words, and the
        median ``worst m``.
    """
    columns = ["alarms", "good", "squares", "times", "near_squares", "near"]
    values = drives[columns].to_numpy(np.float64)
    units = np.arange(len(values))
    drawn, total = resampled_sums(values, units, resamples=resamples), values.sum(0)
    tail = tail_probability(len(values))

    def told(top: int, bottom: int, root: bool, factor: float, digits: int) -> str:
        if total[bottom] == 0.0:
            return "–"
        ratios = np.append(drawn[:, top] / drawn[:, bottom], total[top] / total[bottom])
        ratios = factor * (np.sqrt(ratios) if root else ratios)
        low, high = np.quantile(ratios[:-1], (tail, 1.0 - tail))
        middle = f"{ratios[-1]:.{digits}f}"
        if len(values) < 2 or not math.isfinite(low):
            return middle
        return f"{middle} ({low:.{digits}f}-{high:.{digits}f})"

    return {
        "false alarms %": told(0, 1, root=False, factor=100.0, digits=2),
        "RMS m": told(2, 3, root=True, factor=1.0, digits=2),
        "RMS near m": told(4, 5, root=True, factor=1.0, digits=2),
        "worst m": f"{drives['worst'].median():.1f}",
    }
