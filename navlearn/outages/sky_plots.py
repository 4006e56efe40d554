"""Figure of partial outages: the sky over the car when each starts, and what stays of it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from navlearn.outages.canvas import FIX, INK, PALETTE, new_figure, save
from navlearn.outages.schedule import Outage
from navlearn.outages.sky import Sky

SKIES_PER_ROW = 5


def plot_skies(path: Path, skies: Sequence[Sky], outages: Sequence[Outage], most: int = 20) -> Path:
    """Draw the satellites over the car when each outage starts, those that stay marked.

    Args:
        path: The PNG to write.
        skies: Satellites of the last reception before each outage.
        outages: The outages.
        most: Draw at most this many, the first ones.

    Returns:
        The path.
    """
    shown = list(zip(skies, outages, strict=True))[:most]
    columns = min(SKIES_PER_ROW, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(2.7 * columns + 0.3, 2.9 * rows + 0.3)
    for k, (sky, outage) in enumerate(shown, start=1):
        axes = figure.add_subplot(rows, columns, k, projection="polar")
        axes.set_theta_zero_location("N")  # type: ignore[attr-defined]
        axes.set_theta_direction(-1)  # type: ignore[attr-defined]
        axes.set_ylim(0.0, 90.0)
        axes.set_yticks([30.0, 60.0, 90.0], ["", "", ""])
        axes.set_xticks(np.radians([0.0, 90.0, 180.0, 270.0]), ["N", "E", "S", "W"])
        axes.tick_params(colors=INK, labelsize=8)
        axes.grid(visible=True, color="#E3E6EA", linewidth=0.7)
        for name, azimuth, elevation in zip(sky.names, sky.azimuth, sky.elevation, strict=True):
            stays = name in outage.satellites_visible
            place = (azimuth, 90.0 - np.degrees(elevation))
            axes.plot(
                *place, "o", color=PALETTE[1] if stays else FIX, markersize=8.0 if stays else 5.0
            )
            axes.annotate(
                name, place, xytext=(5, 4), textcoords="offset points", fontsize=7.5, color=INK,
                fontweight="bold" if stays else "normal",
            )  # fmt: skip
        axes.set_title(f"{k}: from {outage.start:.0f} s", fontsize=9.5, color=INK)
    return save(figure, path)
