"""Figure of partial outages: the error against the number of satellites that stay."""

from pathlib import Path

import numpy as np
import pandas as pd

from navlearn.outages.canvas import INK, logarithmic_up, new_figure, save, styles, tidy
from navlearn.outages.naming import axis_label
from navlearn.outages.roles import oracles_last
from navlearn.outages.satellite_tables import METRICS


def plot_by_satellites(path: Path, table: pd.DataFrame) -> Path:
    """Draw the mean error of every method against the number of satellites that stay.

    Args:
        path: The PNG to write.
        table: What :func:`~navlearn.outages.satellite_tables.satellite_table` returned.

    Returns:
        The path.
    """
    lines = table.drop_duplicates(["gyro_class", "duration_s", "satellites", "method"])
    columns = list(lines.groupby(["gyro_class", "duration_s"], sort=False))
    figure = new_figure(1.4 + 4.2 * len(columns), 6.6)
    panels = figure.subplots(len(METRICS), len(columns), squeeze=False, sharex=True, sharey="row")
    look = styles(oracles_last(lines["method"].unique()))
    for k, ((gyro_class, duration), part) in enumerate(columns):
        for axes, (short, metric) in zip(panels[:, k], METRICS.items(), strict=True):
            for name, (color, dash) in look.items():
                mine = part[part["method"] == name].sort_values("satellites")
                x, mean = mine["satellites"].to_numpy(), mine[f"{short}_mean"].to_numpy()
                axes.plot(x, mean, "o", color=color, linestyle=dash, markersize=4.5, label=name)
                ends = mine[[f"{short}_mean_low", f"{short}_mean_high"]].to_numpy(dtype=np.float64)
                axes.vlines(x, ends[:, 0], ends[:, 1], color=color, linewidth=1.0, alpha=0.5)
            logarithmic_up(axes, 0.1)
            tidy(axes, ylabel="mean " + axis_label(metric) if k == 0 else "")
        panels[0, k].set_title(f"{gyro_class}, {duration:g} s", color=INK, fontsize=10)
        panels[-1, k].set_xticks(sorted(lines["satellites"].unique()))
    figure.supxlabel("satellites that stay", color=INK, fontsize=10)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(5, len(labels)), frameon=False
    )
    return save(figure, path)
