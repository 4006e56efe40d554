"""Figures of what filters refused: over time, and where on the road."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.canvas import FIX, INK, REFERENCE, logarithmic_up, new_figure, save, tidy
from navlearn.outages.refused_fixes import nearest_rows
from navlearn.outages.track import Array, Track, enu_metres, local_metres, track_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOOK: Final = {
    "refused_by_gate": ("#D55E00", "x", "refused by the χ² gate"),
    "refused_by_prediction": ("#0072B2", "v", "refused: too far from the prediction"),
    "refused_by_motion": ("#009E73", "^", "refused: moved otherwise than the car"),
    "accepted_with_less_weight": ("#E69F00", ".", "taken with less than half its weight"),
    "accepted_by_reset": ("#B5478D", "o", "taken by a reset"),
}
"""Colour, mark and words of each verdict that is shown."""

PANELS_PER_ROW: Final = 3


def plot_refused_over_time(
    path: Path, tables: Mapping[str, pd.DataFrame], faults: pd.DataFrame | None
) -> Path:
    """Draw how far the positions that each filter refused were from its prediction.

    Args:
        path: The PNG to write.
        tables: What :func:`navlearn.outages.refused_fixes.refused_table` returned, by method.
        faults: Faults that were put into the fixes, drawn as grey stretches; None for none.

    Returns:
        The path.
    """
    figure = new_figure(10.0, 1.2 + 1.9 * len(tables))
    panels = figure.subplots(len(tables), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (name, table) in zip(panels, tables.items(), strict=True):
        positions = table[table["kind"] == "position"]
        if faults is not None:
            for start, lasts in faults[["t", "duration"]].to_numpy(np.float64):
                axes.axvspan(start - 0.5, start + lasts + 0.5, color="#E3E6EA", linewidth=0)
        for verdict, (color, mark, _) in LOOK.items():
            mine = positions[positions["verdict"] == verdict]
            axes.plot(mine["t"], mine["innovation"], mark, color=color, markersize=5)
        if len(positions):
            logarithmic_up(axes, 0.1)
        axes.set_title(name, fontsize=9.5, color=INK, loc="left")
        tidy(axes, ylabel="innovation (m)")
    panels[-1].set_xlabel("time (s)", color=INK)
    _legend(figure, panels[0], {name for t in tables.values() for name in t["verdict"]})
    return save(figure, path)


def plot_refused_map(path: Path, tables: Mapping[str, pd.DataFrame], log: DriveLog) -> Path:
    """Draw where the positions that each filter refused were, and where the car was.

    Args:
        path: The PNG to write.
        tables: As for :func:`plot_refused_over_time`.
        log: The drive.

    Returns:
        The path.
    """
    track = track_of(log)
    origin = (float(track.lat[0]), float(track.lon[0]))
    east, north, _ = local_metres(track, *origin)
    columns = min(PANELS_PER_ROW, len(tables))
    rows = -(-len(tables) // columns)
    shape = float(np.clip(np.ptp(north) / max(np.ptp(east), 1e-9), 0.3, 1.5))
    figure = new_figure(4.2 * columns + 0.6, (4.0 * shape + 0.4) * rows + 1.2)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(tables) :]:
        panel.set_visible(False)
    for axes, (name, table) in zip(panels, tables.items(), strict=False):
        axes.plot(east / 1e3, north / 1e3, color=REFERENCE, linewidth=0.8)
        positions = table[table["kind"] == "position"]
        for verdict, (color, mark, _) in LOOK.items():
            times = positions.loc[positions["verdict"] == verdict, "t"].to_numpy(np.float64)
            _marks(axes, times, log, track, origin, (color, mark))
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(name, fontsize=9.5, color=INK, loc="left")
        tidy(axes)
    figure.supxlabel("east (km)", color=INK, fontsize=10)
    figure.supylabel("north (km)", color=INK, fontsize=10)
    _legend(figure, panels[0], {name for t in tables.values() for name in t["verdict"]})
    return save(figure, path)


def _marks(
    axes: "Axes",
    times: Array,
    log: DriveLog,
    track: Track,
    origin: tuple[float, float],
    look: tuple[str, str],
) -> None:
    """Draw fixes, each joined to where the car was."""
    row = nearest_rows(times, log.fixes["t"].to_numpy(np.float64))
    times, row = times[row >= 0], row[row >= 0]
    lat, lon = (log.fixes[name].to_numpy(np.float64)[row] for name in ("lat", "lon"))
    car_lat, car_lon = (np.interp(times, track.t, x) for x in (track.lat, np.unwrap(track.lon)))
    nothing = np.zeros_like(lat)
    at = enu_metres(lat, lon, nothing, *origin, 0.0)
    was = enu_metres(car_lat, car_lon, nothing, *origin, 0.0)
    axes.plot(*[np.stack((a, b)) / 1e3 for a, b in zip(was[:2], at[:2], strict=True)], color=FIX)
    axes.plot(at[0] / 1e3, at[1] / 1e3, look[1], color=look[0], markersize=5)


def _legend(figure: "Figure", axes: "Axes", shown: Iterable[str]) -> None:
    handles = [
        axes.plot([], [], mark, color=color, label=words)[0]
        for verdict, (color, mark, words) in LOOK.items()
        if verdict in shown
    ]
    if handles:
        figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)
