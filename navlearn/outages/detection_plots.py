"""Figures of faults: how many are caught by size, and against how many false alarms."""

from pathlib import Path

import numpy as np
import pandas as pd

from navlearn.outages.canvas import INK, logarithmic, new_figure, save, styles, tidy


def plot_detection(path: Path, table: pd.DataFrame) -> Path:
    """Draw the share of faults that each way catches against their size, with intervals.

    Args:
        path: The PNG to write.
        table: A row per ``kind``, ``way`` and ``size`` (m): ``share``, ``low``, ``high``. Kinds
            without size are left out.

    Returns:
        The path.
    """
    sized = table.dropna(subset=["size"])
    kinds = list(dict.fromkeys(sized["kind"]))
    figure = new_figure(1.0 + 4.0 * len(kinds), 4.6)
    panels = figure.subplots(1, len(kinds), squeeze=False, sharey=True)[0]
    look = styles(dict.fromkeys(sized["way"]))
    for axes, kind in zip(panels, kinds, strict=True):
        for way, (color, dash) in look.items():
            mine = sized[(sized["kind"] == kind) & (sized["way"] == way)].sort_values("size")
            size, share = mine["size"].to_numpy(), 100.0 * mine["share"].to_numpy()
            axes.plot(size, share, "o", color=color, linestyle=dash, markersize=4, label=way)
            ends = 100.0 * mine[["low", "high"]].to_numpy(np.float64)
            axes.vlines(size, ends[:, 0], ends[:, 1], color=color, linewidth=1.0, alpha=0.5)
        logarithmic(axes)
        tidy(axes, "size (m)", "faults caught (%)" if axes is panels[0] else "")
        axes.set_title(kind, color=INK, fontsize=10)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return save(figure, path)


def plot_operating_curves(path: Path, table: pd.DataFrame) -> Path:
    """Draw the share of faults caught against that of false alarms, over limits.

    Args:
        path: The PNG to write.
        table: A row per ``kind``, ``size``, ``way`` and ``limit``: ``share`` and ``alarms``.

    Returns:
        The path.
    """
    parts = list(table.dropna(subset=["size"]).groupby(["kind", "size"], sort=True))
    columns = min(4, len(parts))
    rows = -(-len(parts) // columns)
    figure = new_figure(1.0 + 3.2 * columns, 1.0 + 3.0 * rows)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    look = styles(dict.fromkeys(table["way"]))
    for axes, ((kind, size), part) in zip(panels, parts, strict=False):
        for way, (color, dash) in look.items():
            mine = part[part["way"] == way].sort_values("limit")
            alarms, share = 100.0 * mine["alarms"], 100.0 * mine["share"]
            axes.plot(alarms, share, "o", color=color, linestyle=dash, markersize=4, label=way)
        axes.set_xscale("symlog", linthresh=0.01)
        axes.set_title(f"{kind}, {size:g} m", color=INK, fontsize=9.5)
        tidy(axes)
    for panel in panels[len(parts) :]:
        panel.set_visible(False)
    figure.supxlabel("good fixes taken for faults (%)", color=INK, fontsize=10)
    figure.supylabel("faults caught (%)", color=INK, fontsize=10)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return save(figure, path)
