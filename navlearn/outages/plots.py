"""Figures of a run: growth and distribution of errors over outages."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from navlearn.outages.canvas import INK, logarithmic, logarithmic_up, new_figure, save, styles, tidy
from navlearn.outages.naming import axis_label
from navlearn.outages.replay import Replay
from navlearn.outages.roles import oracles_last
from navlearn.outages.statistics import HEADLINE
from navlearn.outages.track import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOG_FROM = 20.0
"""Errors are drawn on a logarithmic axis if the largest is this many times the smallest."""


def plot_error_growth(path: Path, replays: Sequence[Replay]) -> Path:
    """Draw how the horizontal error grows through outages: median and quartiles per method.

    Args:
        path: The PNG to write.
        replays: One per drive, with the same methods; their outages are pooled.

    Returns:
        The path.
    """
    methods = oracles_last(str(name) for name in replays[0].rows["method"].unique())
    durations = pd.concat([one.rows["duration_s"] for one in replays])
    grid = np.linspace(0.0, float(durations.max()), 121)
    figure = new_figure(8.0, 4.8)
    axes = figure.subplots()
    ends: list[float] = []
    for name, (color, dash) in styles(methods).items():
        curves = _curves(replays, name, grid)
        if curves.size == 0:
            continue
        low, middle, high = np.nanpercentile(curves, [25.0, 50.0, 75.0], axis=0)
        axes.fill_between(grid, low, high, color=color, alpha=0.13, linewidth=0.0)
        axes.plot(grid, middle, color=color, linestyle=dash, linewidth=2.0, label=name)
        ends.append(float(middle[np.isfinite(middle)][-1]))
    tidy(axes, "time since GNSS was lost (s)", "horizontal error (m)")
    axes.set_xlim(0.0, grid[-1])
    if ends and max(ends) > LOG_FROM * min(ends):
        logarithmic_up(axes, 0.1)
    else:
        axes.set_ylim(bottom=0.0)
    outages = sum(int((one.rows["method"] == methods[0]).sum()) for one in replays)
    axes.set_title(f"Error growth, {outages} outages: median and quartiles", color=INK)
    axes.legend(frameon=False, loc="upper left")
    return save(figure, path)


def plot_distribution(path: Path, rows: pd.DataFrame, metric: str = HEADLINE) -> Path:
    """Draw how a figure is distributed over outages: boxes with every outage, and shares.

    Args:
        path: The PNG to write.
        rows: Table of outages, as ``outages.csv``.
        metric: Its column.

    Returns:
        The path.
    """
    methods = oracles_last(str(name) for name in rows["method"].unique())
    found = {name: np.sort(_values(rows, name, metric)) for name in methods}
    figure = new_figure(10.5, 1.8 + 0.75 * len(methods) if len(methods) > 4 else 4.4)
    boxes, shares = figure.subplots(1, 2, sharex=True, width_ratios=(1.15, 1.0))
    rng = np.random.default_rng(0)
    for place, (name, (color, dash)) in enumerate(styles(methods).items()):
        values = found[name]
        if values.size == 0:
            continue
        _box(boxes, values, -place, color)
        boxes.plot(
            values,
            -place + rng.uniform(-0.16, 0.16, values.size),
            "o",
            color=color,
            markersize=3.5,
            alpha=0.7,
            markeredgewidth=0.0,
        )
        shares.step(
            np.concatenate(([values[0]], values)),
            np.linspace(0.0, 100.0, values.size + 1),
            where="post",
            color=color,
            linestyle=dash,
            linewidth=2.0,
            label=name,
        )
    boxes.set_yticks([-place for place in range(len(methods))], methods)
    every = np.concatenate(list(found.values()))
    if every.size and every.min() > 0.0 and every.max() > LOG_FROM * every.min():
        logarithmic(boxes)
    label = axis_label(metric)
    tidy(boxes, label)
    tidy(shares, label, "share of outages with less (%)")
    shares.set_ylim(0.0, 101.0)
    shares.legend(loc="best", framealpha=0.85, edgecolor="none")
    return save(figure, path)


def _box(axes: "Axes", values: Array, place: float, color: str) -> None:
    axes.boxplot(
        values,
        positions=[place],
        orientation="horizontal",
        widths=0.55,
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops={"facecolor": color, "alpha": 0.22, "edgecolor": color},
        medianprops={"color": color, "linewidth": 2.2},
        whiskerprops={"color": color},
        capprops={"color": color},
    )


def _curves(replays: Sequence[Replay], name: str, grid: Array) -> Array:
    curves = []
    for one in replays:
        for (method, _), errors in one.errors.items():
            if method == name:
                since = errors["since_start"].to_numpy()
                curve = np.interp(grid, since, errors["horizontal"].to_numpy(), right=np.nan)
                # A reference of 1 Hz may end a little before the outage does.
                step = float(np.median(np.diff(since))) if since.size > 1 else 0.0
                near = (grid > since[-1]) & (grid <= since[-1] + step)
                curve[near] = errors["horizontal"].iloc[-1]
                curves.append(curve)
    return np.array(curves)


def _values(rows: pd.DataFrame, name: str, metric: str) -> Array:
    values = np.asarray(rows.loc[rows["method"] == name, metric], dtype=np.float64)
    return values[np.isfinite(values)]
