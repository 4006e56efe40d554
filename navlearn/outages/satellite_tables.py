"""Tables by the number of satellites that stay: what each method makes of three, two, one, none."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from navlearn.outages.bootstrap import resampled_sums, tail_probability
from navlearn.outages.cells import are_partial, cells_of
from navlearn.outages.markdown import markdown_table, number, signed
from navlearn.outages.roles import oracles_last, role_of
from navlearn.outages.run_summary import MethodSummary
from navlearn.outages.statistics import Intervals, compare_columns, error_table, units_of
from navlearn.outages.sweep_summary import SweepSummary

RMS, LARGEST = "rms_horizontal_error_m", "max_horizontal_error_m"
METRICS = {"rms": RMS, "max": LARGEST}
"""Figures of the table, by how the names of its columns begin."""


def satellite_table(
    rows: pd.DataFrame,
    methods: Mapping[str, MethodSummary],
    baselines: Sequence[str],
    *,
    resamples: int = 5000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return one line per class, duration, number of satellites, method and baseline.

    Args:
        rows: Tables of outages of all cells, as ``outages.csv``, with ``gyro_class``.
        methods: By name, in the order of the lines.
        baselines: Methods that the others are compared with; those not run are left out.
        resamples: Bootstrap draws.
        seed: Of the draws.

    Returns:
        ``gyro_class``, ``duration_s``, ``satellites``, ``method``, ``role``, ``against``,
        ``outages``, ``failed``; then for ``rms`` and ``max`` each ``_mean``, ``_mean_low``,
        ``_mean_high`` (m), ``_improvement_percent``, ``_low_percent``, ``_high_percent`` (ratio of
        means; NaN for the baseline itself), ``_harm_count``; ``units`` and ``drawn_by`` of the
        bootstrap. Most satellites first.
    """
    drawn: Intervals = {"resamples": resamples, "seed": seed}
    lines = []
    for cell, part in cells_of(rows):
        errors = {short: error_table(part, metric) for short, metric in METRICS.items()}
        names = [name for name in methods if name in errors["rms"].columns]
        for baseline in (name for name in baselines if name in names):
            for name in names:
                line: dict[str, object] = {
                    **cell._asdict(),
                    "method": name,
                    "role": role_of(name, methods[name].regime),
                    "against": baseline,
                    "outages": int(errors["rms"][name].size),
                    "failed": int(errors["rms"][name].isna().sum()),
                }
                for short, table in errors.items():
                    found = _figures(table, name, baseline, drawn)
                    line |= {f"{short}_{key}": value for key, value in found.items()}
                units, line["drawn_by"] = units_of(errors["rms"].index)
                line["units"] = np.unique(units).size
                lines.append(line)
    table = pd.DataFrame(lines).rename(columns={"duration": "duration_s"})
    classes = {name: k for k, name in enumerate(dict.fromkeys(table["gyro_class"]))}
    return (
        table.assign(order=table["gyro_class"].map(classes), fewer=-table["satellites"])
        .sort_values(["order", "duration_s", "fewer"], kind="stable")
        .drop(columns=["order", "fewer"])
        .reset_index(drop=True)
    )


def satellites_of(summary: SweepSummary) -> pd.DataFrame | None:
    """Return the table by number of satellites, None where all GNSS is always gone.

    Args:
        summary: The sweep.
    """
    if not are_partial(summary.rows):
        return None
    return satellite_table(
        summary.rows,
        summary.methods,
        (summary.baseline, *summary.also_against),
        resamples=summary.resamples,
        seed=summary.bootstrap_seed,
    )


def _figures(errors: pd.DataFrame, name: str, baseline: str, drawn: Intervals) -> dict[str, object]:
    mean, low, high = mean_with_interval(errors[name], **drawn)
    figures: dict[str, object] = {"mean": mean, "mean_low": low, "mean_high": high}
    if name == baseline:
        return figures
    found = compare_columns(errors, name, baseline, **drawn)
    return figures | {
        "improvement_percent": found.improvement_percent,
        "low_percent": found.low_percent,
        "high_percent": found.high_percent,
        "harm_count": found.harm_count,
    }


def mean_with_interval(
    values: "pd.Series[float]",
    *,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> tuple[float, float, float]:
    """Return the mean of a figure over outages, with its bootstrap interval.

    Args:
        values: A column of :func:`~navlearn.outages.statistics.error_table`.
        confidence: Of the interval.
        resamples: Bootstrap draws.
        seed: Of the draws.

    Returns:
        Mean, lower and upper end; the ends NaN where there is at most one unit to draw.
    """
    known = values.dropna()
    units, _ = units_of(known.index)
    count = np.unique(units).size
    mean = float(known.mean()) if len(known) else float("nan")
    if count < 2:
        return mean, float("nan"), float("nan")
    columns = np.stack([known.to_numpy(dtype=np.float64), np.ones(len(known))], axis=1)
    sums = resampled_sums(columns, units, resamples=resamples, seed=seed)
    tail = 100.0 * tail_probability(count, confidence)
    low, high = np.percentile(sums[:, 0] / sums[:, 1], [tail, 100.0 - tail])
    return mean, float(low), float(high)


def satellite_section(table: pd.DataFrame) -> list[str]:
    """Return the section of a report by number of satellites as Markdown.

    Args:
        table: What :func:`satellite_table` returned.
    """
    drawn = " or ".join(sorted(set(table["drawn_by"])))
    out = [
        "## By number of satellites\n",
        "Means over the outages; improvement of a mean as a ratio of means, with its 95 % interval "
        f"by a paired bootstrap drawn by {drawn}. RMS is over the time of an outage, the figure "
        "that papers on partial outages print; over 10 % worse is counted by it.\n",
    ]
    for (gyro_class, duration), part in table.groupby(["gyro_class", "duration_s"], sort=False):
        for baseline, lines in part.groupby("against", sort=False):
            out.append(f"**{gyro_class}, {duration:g} s, against `{baseline}`.**\n")
            out.append(_markdown(lines, str(baseline)))
    return out


def _markdown(lines: pd.DataFrame, baseline: str) -> str:
    header = (
        "satellites", "method", "mean RMS m", "improvement %", "95 % interval", "mean maximum m",
        "improvement %", "95 % interval", "over 10 % worse in", "outages", "failed",
    )  # fmt: skip
    cells = []
    for satellites, part in lines.groupby("satellites", sort=False):
        told = {str(line["method"]): line for _, line in part.iterrows()}
        for name in oracles_last(told):
            one = told[name]
            figures = []
            for short in METRICS:
                gain, low, high = (
                    float(one[f"{short}_{end}_percent"]) for end in ("improvement", "low", "high")
                )
                interval = f"{signed(low)} to {signed(high)}" if np.isfinite(low + high) else "–"
                figures += [number(one[f"{short}_mean"]), signed(gain), interval]
            harm = "–" if name == baseline else f"{one['rms_harm_count']:.0f}"
            counts = (harm, str(one["outages"]), str(one["failed"]))
            cells.append((str(satellites), name, *figures, *counts))
    return markdown_table(header, cells, texts=2)
