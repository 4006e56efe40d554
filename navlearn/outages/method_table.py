"""One row per method: averages, comparisons with baselines, and the share of the oracle's gain."""

import pandas as pd

from navlearn.outages.oracle_share import share_columns, share_of_columns
from navlearn.outages.roles import ORACLE
from navlearn.outages.statistics import HEADLINE, Intervals, averages, compare_columns, error_table


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
        the fields of :class:`~navlearn.outages.statistics.Comparison`, each followed by ``_vs_``
        and the baseline's name; then, where there is an oracle, the columns of
        :func:`~navlearn.outages.oracle_share.share_columns`, counted from the first baseline;
        empty (NaN) where a method would be compared with itself.

    Raises:
        ConfigError: The metric is not in the table, or an outage comes twice.
    """
    drawn: Intervals = {"confidence": confidence, "resamples": resamples, "seed": seed}
    errors = error_table(rows, metric)
    present = [name for name in baselines if name in errors.columns]
    measured = bool(present) and ORACLE in errors.columns
    table = []
    for method in rows["method"].unique():
        line: dict[str, object] = {"method": method, **vars(averages(rows, method, metric))}
        for baseline in present:
            if method != baseline:
                found = compare_columns(errors, method, baseline, **drawn)
                line |= {f"{key}_vs_{baseline}": value for key, value in vars(found).items()}
        if measured and method not in (present[0], ORACLE):
            line |= share_columns(share_of_columns(errors, method, present[0], **drawn))
        table.append(line)
    return pd.DataFrame(table)
