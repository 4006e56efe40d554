"""Writes the files of a sweep: all outages, the table over cells, its figure, the report."""

import json
import warnings
from dataclasses import asdict, replace

import pandas as pd

from navlearn.errors import ConfigError
from navlearn.outages.canvas import plots_possible
from navlearn.outages.cells import KEYS, cells_of
from navlearn.outages.output import OutputFolder
from navlearn.outages.satellite_plots import plot_by_satellites
from navlearn.outages.satellite_tables import satellites_of
from navlearn.outages.sweep_plots import plot_improvements
from navlearn.outages.sweep_summary import SweepSummary
from navlearn.outages.sweep_tables import sweep_table
from navlearn.outages.sweep_text import sweep_text
from navlearn.outages.sweep_wording import sweep_meaning, sweep_warnings
from navlearn.outages.tables import without_nan, write_outages_csv

PICTURE = "improvement.png"
BY_SATELLITES = "satellites.png"


def write_sweep_report(output: OutputFolder, summary: SweepSummary) -> SweepSummary:
    """Write ``outages.csv``, ``cells.csv``, ``summary.json``, the figures and ``report.md``.

    Where satellites stay through outages, ``satellites.csv`` too. Without matplotlib the figures
    are left out, with a warning.

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
    by_satellites = satellites_of(summary)
    if by_satellites is not None:
        file = output.claim("satellites.csv")
        by_satellites.to_csv(file, index=False, lineterminator="\n")
    if plots_possible():
        figures = _drawn(output, summary, table, by_satellites)
        summary = replace(summary, figures=figures)
    else:
        warnings.warn(
            "no figure was drawn: matplotlib is missing; pip install 'navlearn[report]'",
            stacklevel=2,
        )
    content = json.dumps(without_nan(sweep_content(summary, table)), indent=2, ensure_ascii=False)
    output.claim("summary.json").write_text(content + "\n", encoding="utf-8")
    text = sweep_text(summary, table, by_satellites)
    output.claim("report.md").write_text(text, encoding="utf-8")
    return summary


def _drawn(
    output: OutputFolder,
    summary: SweepSummary,
    table: pd.DataFrame,
    by_satellites: pd.DataFrame | None,
) -> dict[str, str]:
    """Draw the figures, and return their captions by file name."""
    plot_improvements(output.claim(PICTURE), table)
    captions = {
        PICTURE: f"Improvement of the mean error over `{summary.baseline}` with its 95 % interval, "
        "by class and duration. Dots: learned; squares: baselines; diamonds: post-processing; grey "
        "bars: oracles, which no car can be. The shaded strip is the margin within which a method "
        "counts as harmless; arrows tell figures farther to the left."
    }
    if by_satellites is not None:
        plot_by_satellites(output.claim(BY_SATELLITES), by_satellites)
        captions[BY_SATELLITES] = (
            "Mean error over the outages against the number of satellites that stay; bars: 95 % "
            "interval of the mean. Intervals of one method overlap more easily than the paired "
            "comparison in the table allows to say."
        )
    return captions


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
    found = dict(cells_of(rows))
    stated = [cell.key for cell in summary.cells]
    for key in stated:
        if key not in found:
            raise ConfigError(
                f"sweep: no rows of class {key.gyro_class} at {key.duration:g} s with "
                f"{key.satellites} satellites; run that cell or leave it out"
            )
    if len(stated) != len(set(stated)) or len(stated) != len(found):
        raise ConfigError(
            "sweep: some rows belong to no cell, or to two; the cells are "
            f"{[tuple(key) for key in stated]}"
        )
    return pd.concat([found[key] for key in stated], ignore_index=True)


def table_of(summary: SweepSummary) -> pd.DataFrame:
    """Return the table of a sweep, a line per cell and method.

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
    by_satellites = satellites_of(summary)
    told = [] if by_satellites is None else by_satellites.to_dict(orient="records")
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
        "by_satellites": told,
        "published": [asdict(one) for one in summary.published],
        "figures": dict(summary.figures),
    }
