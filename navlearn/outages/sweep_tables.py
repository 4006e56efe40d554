"""Tables over the cells of a sweep: one line per method in each."""

import math
from collections.abc import Mapping
from dataclasses import fields

import pandas as pd

from navlearn.errors import ConfigError
from navlearn.outages.acting import acting
from navlearn.outages.cells import KEYS, cell_of, cells_of, conditions
from navlearn.outages.markdown import markdown_table, number, signed
from navlearn.outages.oracle_share import share_columns, share_of_columns
from navlearn.outages.roles import ORACLE, role_of, verdict_words
from navlearn.outages.run_summary import MethodSummary
from navlearn.outages.statistics import (
    HEADLINE,
    Comparison,
    Intervals,
    averages_of,
    compare_columns,
    error_table,
)

COLUMNS = (
    *(*KEYS, "method", "role", "drives", "outages", "failed", "mean", "median", "p90"),
    *(field.name for field in fields(Comparison) if field.name != "failed"),
    *("failed_alone", "oracle_share_percent", "oracle_share_low_percent"),
    *("oracle_share_high_percent", "oracle_share_unknown_because", "acted", "asked"),
)
"""Columns of a sweep's table."""


def sweep_table(
    rows: pd.DataFrame,
    methods: Mapping[str, MethodSummary],
    *,
    baseline: str = "ekf",
    metric: str = HEADLINE,
    confidence: float = 0.95,
    resamples: int = 5000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return one line per cell and method.

    Args:
        rows: Tables of outages of all cells, as ``outages.csv``, with ``gyro_class``.
        methods: By name, in the order of the lines; a cell may lack some.
        baseline: Method that the others are compared with.
        metric: Column to judge by.
        confidence: Of the intervals.
        resamples: Bootstrap draws.
        seed: Of the draws.

    Returns:
        ``gyro_class``, ``duration_s``, ``satellites``, ``method``, ``role``, ``drives``;
        ``outages``, ``failed``, ``mean``, ``median``, ``p90``; the fields of
        :class:`~navlearn.outages.statistics.Comparison` against the baseline, but failures of
        the method alone are ``failed_alone``; the columns of
        :func:`~navlearn.outages.oracle_share.share_columns`; ``acted`` in how many of ``asked``
        outages. Empty where a method has none of it.

    Raises:
        ConfigError: A column is missing, a cell lacks the baseline, a method is not among
            ``methods``, or an outage comes twice.
    """
    _check(rows, methods)
    drawn: Intervals = {"confidence": confidence, "resamples": resamples, "seed": seed}
    table: list[dict[str, object]] = []
    for cell, part in cells_of(rows):
        errors = error_table(part, metric)
        if baseline not in errors.columns:
            raise ConfigError(
                f"sweep: class {cell.gyro_class} at {conditions(rows)[cell]} has no method "
                f"{baseline!r} to compare with; there are {list(errors.columns)}"
            )
        of_method = dict(list(part.groupby("method", sort=False)))
        for name in (name for name in methods if name in of_method):
            mine = of_method[name]
            table.append(
                {
                    **dict(zip(KEYS, cell, strict=True)),
                    "method": name,
                    "role": role_of(name, methods[name].regime),
                    "drives": mine["drive"].nunique(),
                    **_figures(errors, name, baseline, drawn),
                    **vars(averages_of(mine[metric].to_numpy(dtype=float))),
                    **_acting(mine, name),
                }
            )
    return pd.DataFrame(table, columns=list(COLUMNS))


def _figures(errors: pd.DataFrame, name: str, baseline: str, drawn: Intervals) -> dict[str, object]:
    """Return a method's comparison with the baseline and its share of the oracle's gain."""
    line: dict[str, object] = {}
    if name != baseline:
        line |= vars(compare_columns(errors, name, baseline, **drawn))
        line["failed_alone"] = line.pop("failed")
    if name not in (baseline, ORACLE):
        line |= share_columns(share_of_columns(errors, name, baseline, **drawn))
    return line


def _acting(rows: pd.DataFrame, name: str) -> dict[str, object]:
    verdicts = acting(rows, name)
    return {} if verdicts is None else dict(vars(verdicts))


def overview_markdown(table: pd.DataFrame) -> str:
    """Return the improvement of every method in every cell, with its interval, as Markdown.

    Args:
        table: What :func:`sweep_table` returned.
    """
    told = conditions(table)
    lines = []
    for name in table["method"].unique():
        mine = {cell_of(line): _gain(line) for _, line in table[table["method"] == name].iterrows()}
        lines.append([str(name), *(mine.get(cell, "") for cell in told)])
    header = ("method", *(f"{cell.gyro_class}, {words}" for cell, words in told.items()))
    return markdown_table(header, lines)


def cell_markdown(part: pd.DataFrame) -> str:
    """Return some lines of one cell as Markdown.

    Args:
        part: Lines of :func:`sweep_table`.
    """
    header = (
        "method", "verdict", "mean m", "90 % m", "improvement %", "95 % interval", "better in %",
        "over 10 % worse in", "acted in", "share of oracle %", "outages", "failed",
    )  # fmt: skip
    lines = []
    for _, one in part.iterrows():
        compared = isinstance(one["verdict"], str)
        lines.append(
            (
                str(one["method"]),
                verdict_of_line(one),
                number(one["mean"]),
                number(one["p90"]),
                signed(one["improvement_percent"]),
                _interval(one["low_percent"], one["high_percent"]),
                number(one["win_rate_percent"], 0),
                f"{one['harm_count']:.0f}" if compared else "–",
                f"{one['acted']:.0f} of {one['asked']:.0f}" if one["asked"] > 0 else "–",
                _share(one),
                str(one["outages"]),
                str(one["failed"]),
            )
        )
    return markdown_table(header, lines, texts=2)


def verdict_of_line(line: pd.Series) -> str:
    """Return what a line of the table says of its method.

    Args:
        line: A line of :func:`sweep_table`.
    """
    if not isinstance(line["verdict"], str):
        return "–"
    same = line["ties"] == line["pairs"] and line["failed_alone"] == 0
    return verdict_words(line["verdict"], line["role"], never_differs=bool(same))


def _gain(line: pd.Series) -> str:
    if not isinstance(line["verdict"], str):
        return f"{number(line['mean'])} m"
    interval = _interval(line["low_percent"], line["high_percent"])
    return f"{signed(line['improvement_percent'])} ({interval})"


def _interval(low: float, high: float) -> str:
    return f"{signed(low)} to {signed(high)}" if math.isfinite(low + high) else "–"


def _share(line: pd.Series) -> str:
    share = line["oracle_share_percent"]
    if not math.isfinite(share):
        return "–"
    low, high = line["oracle_share_low_percent"], line["oracle_share_high_percent"]
    return f"{number(share, 0)} ({number(low, 0)} to {number(high, 0)})"


def _check(rows: pd.DataFrame, methods: Mapping[str, MethodSummary]) -> None:
    missing = [name for name in (*KEYS, "drive", "method", "outage") if name not in rows.columns]
    if missing:
        raise ConfigError(
            f"sweep: the rows lack the columns {missing}; take them from replays and add the class"
        )
    unknown = sorted(set(rows["method"].unique()) - methods.keys())
    if unknown:
        raise ConfigError(
            f"sweep: the rows have the methods {unknown}, of which nothing is told; there are "
            f"{list(methods)}"
        )
