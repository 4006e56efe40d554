"""Maps of a run: the drive with its outages, and how solutions drift away from the car."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.canvas import FIX, INK, REFERENCE, ROAD, Dash, new_figure, save, styles, tidy
from navlearn.outages.metrics import road_figures
from navlearn.outages.replay import Replay
from navlearn.outages.roles import oracles_last
from navlearn.outages.schedule import Outage
from navlearn.outages.track import Array, Track, enu_metres, local_metres, track_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANELS_PER_ROW = 5

FAR = 6.0
"""A drift of so many times the median method's leaves its panel, so that the others are seen."""


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
        """Names of the methods, in the order of the run, oracles last."""
        return oracles_last(str(name) for name in self.replay.rows["method"].unique())


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
    east, north = _track_kilometres(track, origin)
    shape = float(np.ptp(north) / max(np.ptp(east), 1e-9))
    figure = new_figure(9.0, float(np.clip(8.0 * shape, 4.5, 9.0)) + 0.8)
    axes = figure.subplots()
    fixes = scene.log.fixes.dropna(subset=["lat", "lon"])
    fix_e, fix_n = _kilometres(fixes, origin)
    axes.plot(fix_e, fix_n, ".", color=FIX, markersize=2.5, label="GNSS fixes", zorder=1)
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
            bbox={
                "boxstyle": "round,pad=0.12",
                "facecolor": "white",
                "alpha": 0.75,
                "linewidth": 0,
            },
        )
    for name, (color, dash) in styles(scene.methods).items():
        _drifts(axes, scene, name, origin, color, dash)
    axes.set_aspect("equal", adjustable="datalim")
    tidy(axes, "east (km)", "north (km)")
    axes.set_title(f"{scene.log.metadata.name}: track and outages", color=INK)
    axes.legend(frameon=False, fontsize=9, loc="best")
    return save(figure, path)


def plot_drifts(path: Path, scene: Scene, most: int = 20) -> Path:
    """Draw every outage as seen by the car: how each solution drifts away from the truth.

    The cross is the truth throughout, a dot ends each drift; the sketch in the corner is the
    road driven, north up.

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
    figure = new_figure(2.7 * columns + 0.4, 2.8 * rows + 0.9)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(shown) :]:
        panel.set_visible(False)
    for panel, (number, outage) in zip(panels, shown, strict=False):
        _drift_panel(panel, scene, track, number, outage)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(6, len(labels)), frameon=False
    )
    figure.supxlabel("error to the east (m)", color=INK, fontsize=10)
    figure.supylabel("error to the north (m)", color=INK, fontsize=10)
    return save(figure, path)


def _drift_panel(axes: "Axes", scene: Scene, track: Track, number: int, outage: Outage) -> None:
    reach, away = _reach(scene, number)
    for name, (color, dash) in styles(scene.methods).items():
        errors = scene.replay.errors.get((name, number))
        if errors is None:
            axes.plot([], [], color=color, linestyle=dash, linewidth=1.7, label=name)
            continue
        east, north = errors["east"].to_numpy(), errors["north"].to_numpy()
        axes.plot(east, north, color=color, linestyle=dash, linewidth=1.7, label=name)
        axes.plot(east[-1], north[-1], "o", color=color, markersize=5.5)
    axes.plot(0.0, 0.0, marker="+", color=REFERENCE, markersize=11, markeredgewidth=1.6, zorder=5)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    tidy(axes)
    axes.tick_params(labelsize=7.5)
    part = track.between(outage.start, outage.end)
    length = road_figures(track, outage)["distance_m"]
    axes.set_title(f"{number}: from {outage.start:.0f} s, {length:.0f} m", fontsize=9.5, color=INK)
    if away:
        axes.text(
            0.5, 0.02, "\n".join(away), transform=axes.transAxes, fontsize=7.5, color=INK,
            ha="center", va="bottom",
        )  # fmt: skip
    _road_sketch(axes, part, _free_corner(scene, number))


def _reach(scene: Scene, number: int) -> tuple[float, list[str]]:
    """Return the half width of a panel, m, and words for methods that drift far out of it."""
    largest = {
        name: float(scene.replay.errors[name, number]["horizontal"].max())
        for name in scene.methods
        if (name, number) in scene.replay.errors
    }
    if not largest:
        return 1.0, []
    limit = FAR * float(np.median(list(largest.values())))
    inside = [value for value in largest.values() if value <= limit] or list(largest.values())
    away = [f"{name} leaves: {value:.0f} m" for name, value in largest.items() if value > limit]
    return 1.35 * max(*inside, 1.0), away


def _free_corner(scene: Scene, number: int) -> tuple[float, float]:
    """Return the corner (0 or 1 to the right, 0 or 1 up) with the fewest drift samples."""
    errors = [one for (_, k), one in scene.replay.errors.items() if k == number]
    east = np.concatenate([one["east"].to_numpy() for one in errors] or [np.zeros(1)])
    north = np.concatenate([one["north"].to_numpy() for one in errors] or [np.zeros(1)])
    far = np.hypot(east, north) > 0.3 * np.hypot(east, north).max()
    corners = [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)]
    crowd = [int((far & ((east > 0) == x) & ((north > 0) == y)).sum()) for x, y in corners]
    return corners[int(np.argmin(crowd))]


def _road_sketch(axes: "Axes", part: Track, corner: tuple[float, float]) -> None:
    sketch = axes.inset_axes((0.73 * corner[0], 0.73 * corner[1], 0.27, 0.27), zorder=0.5)
    east, north, _ = local_metres(part, float(part.lat[0]), float(part.lon[0]))
    sketch.plot(east, north, color=ROAD, linewidth=1.6)
    sketch.plot(east[-1], north[-1], "o", color=ROAD, markersize=3.5)
    sketch.set_aspect("equal", adjustable="datalim")
    sketch.margins(0.12)
    sketch.axis("off")


def _drifts(
    axes: "Axes", scene: Scene, name: str, origin: tuple[float, float], color: str, dash: Dash
) -> None:
    label: str | None = name
    for number in range(1, len(scene.outages) + 1):
        solution = scene.replay.solutions.get((name, number))
        if solution is None:
            continue
        east, north = _kilometres(solution.table, origin)
        axes.plot(east, north, color=color, linestyle=dash, linewidth=1.3, label=label, zorder=3)
        label = None


def _kilometres(table: pd.DataFrame, origin: tuple[float, float]) -> tuple[Array, Array]:
    lat, lon = (np.asarray(table[name], dtype=np.float64) for name in ("lat", "lon"))
    east, north, _ = enu_metres(lat, lon, np.zeros_like(lat), *origin, 0.0)
    return east / 1000.0, north / 1000.0


def _track_kilometres(track: Track, origin: tuple[float, float]) -> tuple[Array, Array]:
    east, north, _ = local_metres(track, *origin)
    return east / 1000.0, north / 1000.0


def _name_of(track: Track) -> str:
    return {"fixes": "GNSS fixes, joined"}.get(track.origin, track.origin)
