"""Figures of a run: the track with its outages, drifts, growth and distribution of errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.canvas import FIX, INK, REFERENCE, new_figure, save, styles, tidy
from navlearn.outages.replay import Replay
from navlearn.outages.schedule import Outage
from navlearn.outages.statistics import HEADLINE
from navlearn.outages.track import Array, Track, enu_metres, local_metres, track_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANELS_PER_ROW = 5


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One drive as figures show it.

    Attributes:
        log: The whole drive.
        outages: Its outages, in order of time.
        replay: What came of them.
    """

    log: DriveLog
    outages: Sequence[Outage]
    replay: Replay

    @property
    def methods(self) -> list[str]:
        """Names of the methods, in the order of the run."""
        return [str(name) for name in self.replay.rows["method"].unique()]


def plot_track(path: Path, scene: Scene) -> Path:
    """Draw the drive seen from above, its outages marked and numbered.

    Args:
        path: The PNG to write.
        scene: The drive.

    Returns:
        The path.
    """
    track = track_of(scene.log)
    origin = (float(track.lat[0]), float(track.lon[0]))
    figure = new_figure(9.0, 7.0)
    axes = figure.subplots()
    fixes = scene.log.fixes.dropna(subset=["lat", "lon"])
    fix_e, fix_n = _kilometres(fixes, origin)
    axes.plot(fix_e, fix_n, ".", color=FIX, markersize=2.5, label="GNSS fixes", zorder=1)
    east, north = _track_kilometres(track, origin)
    axes.plot(east, north, color=REFERENCE, linewidth=0.9, label=_name_of(track), zorder=2)
    for number, outage in enumerate(scene.outages, start=1):
        part = track.between(outage.start, outage.end)
        part_e, part_n = _track_kilometres(part, origin)
        label = "outage" if number == 1 else None
        axes.plot(
            part_e,
            part_n,
            color="#F0C808",
            linewidth=6.0,
            alpha=0.75,
            label=label,
            zorder=1.5,
            solid_capstyle="round",
        )
        axes.annotate(
            str(number),
            (part_e[0], part_n[0]),
            xytext=(5, 5),
            textcoords="offset points",
            fontsize=9,
            fontweight="bold",
            color=INK,
        )
    for name, (color, dash) in styles(scene.methods).items():
        _drifts(axes, scene, name, origin, color, dash)
    axes.set_aspect("equal", adjustable="datalim")
    tidy(axes, "east (km)", "north (km)")
    axes.set_title(f"{scene.log.metadata.name}: track and outages", color=INK)
    axes.legend(frameon=False, fontsize=9, loc="best")
    return save(figure, path)


def plot_outage_maps(path: Path, scene: Scene, most: int = 20) -> Path:
    """Draw every outage seen from above, north up, metres from its start.

    A dot ends each drift; a thin line joins it to where the car really was.

    Args:
        path: The PNG to write.
        scene: The drive.
        most: Draw at most this many outages, the first ones.

    Returns:
        The path.
    """
    track = track_of(scene.log)
    shown = list(enumerate(scene.outages, start=1))[:most]
    columns = min(PANELS_PER_ROW, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(3.0 * columns + 0.4, 3.1 * rows + 0.9)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(shown) :]:
        panel.set_visible(False)
    for panel, (number, outage) in zip(panels, shown, strict=False):
        _outage_map(panel, scene, track, number, outage)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(6, len(labels)), frameon=False
    )
    figure.supxlabel("east of the outage's start (m)", color=INK, fontsize=10)
    figure.supylabel("north of the outage's start (m)", color=INK, fontsize=10)
    return save(figure, path)


def plot_error_growth(path: Path, replays: Sequence[Replay]) -> Path:
    """Draw how the horizontal error grows through outages: median and quartiles per method.

    Args:
        path: The PNG to write.
        replays: One per drive, with the same methods; their outages are pooled.

    Returns:
        The path.
    """
    methods = [str(name) for name in replays[0].rows["method"].unique()]
    durations = pd.concat([one.rows["duration_s"] for one in replays])
    grid = np.linspace(0.0, float(durations.max()), 121)
    figure = new_figure(8.0, 4.8)
    axes = figure.subplots()
    for name, (color, dash) in styles(methods).items():
        curves = _curves(replays, name, grid)
        if curves.size == 0:
            continue
        low, middle, high = np.nanpercentile(curves, [25.0, 50.0, 75.0], axis=0)
        axes.fill_between(grid, low, high, color=color, alpha=0.13, linewidth=0.0)
        axes.plot(grid, middle, color=color, linestyle=dash, linewidth=2.0, label=name)
    tidy(axes, "time since the last fix was lost (s)", "horizontal error (m)")
    axes.set_xlim(0.0, grid[-1])
    axes.set_ylim(bottom=0.0)
    outages = (
        len(replays[0].rows[replays[0].rows["method"] == methods[0]])
        if len(replays) == 1
        else sum(len(one.rows[one.rows["method"] == methods[0]]) for one in replays)
    )
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
    methods = [str(name) for name in rows["method"].unique()]
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
    every = np.concatenate([*found.values(), [1.0]])
    positive = every[every > 0.0]
    if positive.max() > 50.0 * positive.min():
        boxes.set_xscale("log")
    label = _label(metric)
    tidy(boxes, label)
    tidy(shares, label, "share of outages with less (%)")
    shares.set_ylim(0.0, 101.0)
    shares.legend(frameon=False, loc="lower right")
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


def _outage_map(axes: "Axes", scene: Scene, track: Track, number: int, outage: Outage) -> None:
    part = track.between(outage.start, outage.end)
    origin = (float(part.lat[0]), float(part.lon[0]))
    east, north, _ = local_metres(part, *origin)
    axes.plot(east, north, color=REFERENCE, linewidth=3.0, alpha=0.45, label=_name_of(track))
    axes.plot(0.0, 0.0, marker="s", color=REFERENCE, markersize=4.5)
    for name, (color, dash) in styles(scene.methods).items():
        solution = scene.replay.solutions.get((name, number))
        if solution is None:
            axes.plot([], [], color=color, linestyle=dash, label=name)
            continue
        e, n = _metres(solution.table, origin)
        axes.plot(e, n, color=color, linestyle=dash, linewidth=1.4, label=name)
        axes.plot(e[-1], n[-1], "o", color=color, markersize=4.5)
        axes.plot([e[-1], east[-1]], [n[-1], north[-1]], color=color, linewidth=0.7, alpha=0.8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    tidy(axes)
    axes.tick_params(labelsize=7.5)
    axes.set_title(f"{number}: from {outage.start:.0f} s", fontsize=9.5, color=INK)


def _drifts(
    axes: "Axes", scene: Scene, name: str, origin: tuple[float, float], color: str, dash: str
) -> None:
    label: str | None = name
    for number in range(1, len(scene.outages) + 1):
        solution = scene.replay.solutions.get((name, number))
        if solution is None:
            continue
        east, north = _kilometres(solution.table, origin)
        axes.plot(east, north, color=color, linestyle=dash, linewidth=1.3, label=label, zorder=3)
        label = None


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


def _metres(table: pd.DataFrame, origin: tuple[float, float]) -> tuple[Array, Array]:
    lat, lon = (np.asarray(table[name], dtype=np.float64) for name in ("lat", "lon"))
    east, north, _ = enu_metres(lat, lon, np.zeros_like(lat), *origin, 0.0)
    return east, north


def _kilometres(table: pd.DataFrame, origin: tuple[float, float]) -> tuple[Array, Array]:
    east, north = _metres(table, origin)
    return east / 1000.0, north / 1000.0


def _track_kilometres(track: Track, origin: tuple[float, float]) -> tuple[Array, Array]:
    east, north, _ = local_metres(track, *origin)
    return east / 1000.0, north / 1000.0


def _name_of(track: Track) -> str:
    return {"fixes": "withheld fixes"}.get(track.origin, track.origin)


def _label(metric: str) -> str:
    units = {"_m_per_s": " (m/s)", "_percent": " (% of distance)", "_deg": " (°)", "_m": " (m)"}
    for ending, unit in units.items():
        if metric.endswith(ending):
            return metric.removesuffix(ending).replace("_", " ") + unit
    return metric.replace("_", " ")
