"""Warns of gains that cannot be true: better in real time than with a gyro without error."""

import math
from collections.abc import Sequence

import pandas as pd

from navlearn.outages.naming import with_unit
from navlearn.outages.roles import BOUND
from navlearn.outages.statistics import HEADLINE, compare_columns, error_table


def leak_warnings(
    rows: pd.DataFrame,
    contenders: Sequence[str],
    *,
    metric: str = HEADLINE,
    resamples: int = 5000,
    seed: int = 0,
    where: str = "",
) -> list[str]:
    """Return a warning for every method that beats the noise-free gyro on the mean.

    Args:
        rows: Table of outages, as ``outages.csv``.
        contenders: Methods that run in real time; those not in the table are left out.
        metric: Column to judge by.
        resamples: Bootstrap draws.
        seed: Of the draws.
        where: Said in front, such as the class of gyros.
    """
    # Where satellites stay, an oracle of the gyro alone bounds nobody who uses their ranges.
    errors = error_table(rows[rows["satellites"] == 0], metric)
    if BOUND not in errors.columns:
        return []
    lines = []
    for name in (name for name in contenders if name in errors.columns):
        both = errors[[name, BOUND]].dropna().to_numpy()
        means = both.mean(axis=0) if len(both) else (math.nan, math.nan)
        if not means[0] < means[1]:
            continue
        found = compare_columns(errors, name, BOUND, resamples=resamples, seed=seed)
        ours, bound = (with_unit(float(mean), metric) for mean in means)
        sure = (
            "the interval excludes chance"
            if found.low_percent > 0.0
            else "the interval includes zero, so it may be chance"
        )
        lines.append(
            f"**Warning.** {where}**{name}** is better than **{BOUND}** ({ours} against {bound} "
            f"on the mean; {sure}). No method that learns the gyro's error can be: a gain above "
            "an oracle points to a leak or a bug, or to something learned besides the gyro."
        )
    return lines
