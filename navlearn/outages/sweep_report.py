"""Writes the files of a sweep: all outages, the table over cells, its figure, the report."""

import json
import warnings
from dataclasses import asdict, replace

import pandas as pd

from navlearn.errors import ConfigError
from navlearn.outages.canvas import plots_possible
from navlearn.outages.output import OutputFolder
from navlearn.outages.sweep_plots import plot_improvements
from navlearn.outages.sweep_summary import SweepSummary
from navlearn.outages.sweep_tables import KEYS, sweep_table
from navlearn.outages.sweep_text import sweep_text
from navlearn.outages.sweep_wording import sweep_meaning, sweep_warnings
from navlearn.outages.tables import without_nan, write_outages_csv

PICTURE = "improvement.png"


def write_sweep_report(output: OutputFolder, summary: SweepSummary) -> SweepSummary:
    """Write ``outages.csv``, ``cells.csv``, ``summary.json``, the figure and ``report.md``.

    Without matplotlib the figure is left out, with a warning.

    Args:
        output: The sweep's folder.
        summary: The sweep; its figures are filled in here, its rows put in the cells' order.

    Returns:
        The summary with its figures.

    Raises:
        OutputExistsError: A file of that name exists which no run wrote.
        ConfigError: Rows, cells and methods do not go together.
    """
    summary = replace(summary, rows=rows_by_cell(summary))
    table = table_of(summary)
    write_outages_csv(output.claim("outages.csv"), summary.rows)
    table.to_csv(output.claim("cells.csv"), index=False, lineterminator="\n")
    if plots_possible():
        plot_improvements(output.claim(PICTURE), table)
        summary = replace(
            summary,
            figures={
                PICTURE: "Improvement of the mean error over "
                f"`{summary.baseline}` with its 95 % interval, by class and duration. Dots: "
                "learned; squares: baselines; diamonds: post-processing; grey bars: oracles, which "
                "no car can be. The shaded strip is the margin within which a method counts as "
                "harmless; arrows tell figures farther to the left."
            },
        )
    else:
        warnings.warn(
            "no figure was drawn: matplotlib is missing; pip install 'navlearn[report]'",
            stacklevel=2,
        )
    content = json.dumps(without_nan(sweep_content(summary, table)), indent=2, ensure_ascii=False)
    output.claim("summary.json").write_text(content + "\n", encoding="utf-8")
    output.claim("report.md").write_text(sweep_text(summary, table), encoding="utf-8")
    return summary


def rows_by_cell(summary: SweepSummary) -> pd.DataFrame:
    """Return the rows of a sweep in the order of its cells.

    Args:
        summary: The sweep.

    Raises:
        ConfigError: A column is missing, a cell has no rows, or rows belong to no cell.
    """
    rows = summary.rows
    missing = [name for name in KEYS if name not in rows.columns]
    if missing:
        raise ConfigError(f"sweep: the rows lack {missing}; add them to what a replay returned")
    parts = []
    for cell in summary.cells:
        part = rows[(rows[KEYS[0]] == cell.gyro_class) & (rows[KEYS[1]] == cell.duration)]
        if part.empty:
            raise ConfigError(
                f"sweep: no rows of class {cell.gyro_class} at {cell.duration:g} s; run that cell "
                "or leave it out"
            )
        parts.append(part)
    if sum(len(part) for part in parts) != len(rows):
        stated = [(cell.gyro_class, cell.duration) for cell in summary.cells]
        raise ConfigError(f"sweep: some rows belong to no cell, or to two; the cells are {stated}")
    return pd.concat(parts, ignore_index=True)


def table_of(summary: SweepSummary) -> pd.DataFrame:
    """Return the table of a sweep, a line per class, duration and method.

    Args:
        summary: The sweep.
    """
    return sweep_table(
        summary.rows,
        summary.methods,
        baseline=summary.baseline,
        metric=summary.metric,
        resamples=summary.resamples,
        seed=summary.bootstrap_seed,
    )


def sweep_content(summary: SweepSummary, table: pd.DataFrame) -> dict[str, object]:
    """Return the content of ``summary.json``.

    Args:
        summary: The sweep.
        table: Its table.
    """
    return {
        "title": summary.title,
        "question": summary.question,
        "remarks": list(summary.remarks),
        "warnings": [line.replace("**", "") for line in sweep_warnings(summary)],
        "meaning": [line.replace("**", "") for line in sweep_meaning(summary, table)],
        "command": summary.command,
        "versions": dict(summary.versions),
        "seeds": {**summary.seeds, "bootstrap": summary.bootstrap_seed},
        "wall_clock_s": summary.wall_clock,
        "processes": summary.processes,
        "metric": summary.metric,
        "baseline": summary.baseline,
        "methods": {name: asdict(about) for name, about in summary.methods.items()},
        "cells": [asdict(cell) for cell in summary.cells],
        "lines": table.to_dict(orient="records"),
        "published": [asdict(one) for one in summary.published],
        "figures": dict(summary.figures),
    }
