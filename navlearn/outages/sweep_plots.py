"""Figure of a sweep: what every method gains, one panel per cell."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from navlearn.outages.canvas import INK, new_figure, save, styles, tidy
from navlearn.outages.cells import Cell, cell_of, conditions
from navlearn.outages.roles import Role, oracles_last
from navlearn.outages.statistics import MARGIN_PERCENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FARTHEST = -60.0
"""A method that makes the error so much larger (%) leaves its panel; its figure is told."""

MARKERS: dict[Role, str] = {
    "baseline": "s",
    "learned": "o",
    "post-processing": "D",
    "oracle": "|",
}

SHADE = "#F3D9C9"


def plot_improvements(path: Path, table: pd.DataFrame) -> Path:
    """Draw every method's improvement over the baseline with its interval.

    Args:
        path: The PNG to write.
        table: What :func:`~navlearn.outages.sweep_tables.sweep_table` returned.

    Returns:
        The path.
    """
    compared = table[np.isfinite(table["improvement_percent"].astype(float))]
    methods = oracles_last(compared["method"].unique())
    told = conditions(table)
    classes = list(dict.fromkeys(cell.gyro_class for cell in told))
    across = list(dict.fromkeys((cell.duration, cell.satellites) for cell in told))
    across.sort(key=lambda one: (one[0], -one[1]))
    height = 1.1 + len(classes) * (0.5 + 0.25 * max(len(methods), 2))
    figure = new_figure(2.2 + (4.0 if len(across) < 4 else 2.8) * len(across), height)
    panels = figure.subplots(len(classes), len(across), squeeze=False, sharex=True, sharey=True)
    look = styles(methods)
    left = max(FARTHEST, 1.1 * min(0.0, _smallest(compared)) - 5.0)
    for row, gyro_class in zip(panels, classes, strict=True):
        for axes, (duration, satellites) in zip(row, across, strict=True):
            cell = Cell(gyro_class, duration, satellites)
            part = compared[[cell_of(line) == cell for _, line in compared.iterrows()]]
            axes.axvspan(MARGIN_PERCENT, 0.0, color=SHADE, linewidth=0.0, zorder=0)
            axes.axvline(0.0, color=INK, linewidth=0.9, zorder=1)
            for _, line in part.iterrows():
                _gain(axes, -methods.index(line["method"]), line, look[line["method"]][0], left)
            tidy(axes)
            words = told.get(cell, f"{duration:g} s")
            axes.set_title(f"{gyro_class}, {words}", color=INK, fontsize=10)
            if part.empty:
                axes.text(0.5, 0.5, "not run", transform=axes.transAxes, ha="center", color=INK)
    panels[0, 0].set_xlim(left, 105.0)
    panels[0, 0].set_yticks([-place for place in range(len(methods))], methods)
    panels[0, 0].set_ylim(-len(methods) + 0.4, 0.6)
    figure.supxlabel("improvement of the mean error (%), 95 % interval", color=INK, fontsize=10)
    return save(figure, path)


def _gain(axes: "Axes", place: int, line: "pd.Series", color: str, left: float) -> None:
    gain, low, high = (
        float(line[name]) for name in ("improvement_percent", "low_percent", "high_percent")
    )
    if math.isfinite(low + high):
        ends = [max(low, left), max(high, left)]
        axes.plot(ends, [place, place], color=color, linewidth=2.0)
    if gain >= left:
        marker = MARKERS[line["role"]]
        axes.plot(
            gain, place, marker, color=color, markersize=9.0 if marker == "|" else 5.0,
            markeredgewidth=2.0 if marker == "|" else 0.5,
        )  # fmt: skip
        return
    axes.plot(left, place, "<", color=color, markersize=6.0, clip_on=False)
    said = f"{gain:.0f} %".replace("-", "−")
    axes.annotate(
        said, (left, place), xytext=(7, 0), textcoords="offset points", va="center",
        fontsize=8, color=color,
    )  # fmt: skip


def _smallest(compared: pd.DataFrame) -> float:
    found = compared[["improvement_percent", "low_percent"]].to_numpy(dtype=np.float64)
    return float(np.nanmin(found)) if found.size else 0.0
