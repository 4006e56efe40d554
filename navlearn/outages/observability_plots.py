"""Figures of the degree of observability: every state, the eigenvalues, the extreme directions."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from navlearn.outages.canvas import INK, PALETTE, new_figure, save, tidy
from navlearn.outages.observability_record import ObservabilityRecord, spoken
from navlearn.outages.schedule import Outage
from navlearn.outages.track import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OUTAGE = "#F3D9C9"
GREY = "#B0B7BF"
NORMS = ("P′: variance against the start", "P″: share of what is unknown")
FLOOR = 1e-12
"""Nothing smaller is drawn: a variance of zero has no logarithm."""


def plot_states(path: Path, record: ObservabilityRecord, outages: Sequence[Outage]) -> Path:
    """Draw one curve per state of both normalised diagonals; states of one unit share a panel.

    Args:
        path: The PNG to write.
        record: The record.
        outages: Shaded, as are standstills.

    Returns:
        The path.
    """
    groups = state_groups(record)
    diagonal = record.against_start
    figure = new_figure(11.0, 0.9 + 1.75 * len(groups))
    panels = figure.subplots(len(groups), 2, squeeze=False, sharex=True)
    for axes, title in zip(panels[0], NORMS, strict=True):
        axes.set_title(title, color=INK, fontsize=10)
    for row, (unit, states) in zip(panels, groups.items(), strict=True):
        for axes, values in zip(row, (diagonal, diagonal * record.to_share), strict=True):
            _shade(axes, record, outages)
            axes.axhline(1.0, color=INK, linewidth=0.8, zorder=1)
            for k, i in enumerate(states):
                color = PALETTE[k % len(PALETTE)]
                _curve(axes, record, values[:, i], color, spoken(record.names[i]))
            _logarithmic(axes)
            tidy(axes, ylabel=unit)
        row[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("time (s)", color=INK)
    return save(figure, path)


def plot_eigenvalues(path: Path, record: ObservabilityRecord, outages: Sequence[Outage]) -> Path:
    """Draw all eigenvalues of P' and P'' over time, the extreme ones in colour.

    Args:
        path: The PNG to write.
        record: The record.
        outages: Shaded, as are standstills.

    Returns:
        The path.
    """
    figure = new_figure(11.0, 3.8)
    for axes, values, title in zip(
        figure.subplots(1, 2),
        (record.eigenvalues, record.eigenvalues * record.to_share),
        NORMS,
        strict=True,
    ):
        _shade(axes, record, outages)
        axes.axhline(1.0, color=INK, linewidth=0.8, zorder=1)
        for column in values.T[1:-1]:
            _curve(axes, record, column, GREY)
        _curve(axes, record, values[:, 0], PALETTE[0], "best observed direction")
        _curve(axes, record, values[:, -1], PALETTE[1], "least observed direction")
        _logarithmic(axes)
        tidy(axes, "time (s)", "eigenvalue")
        axes.set_title(title, color=INK, fontsize=10)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
    return save(figure, path)


def plot_directions(path: Path, record: ObservabilityRecord, outages: Sequence[Outage]) -> Path:
    """Draw what the best and the least observed direction consist of, over time.

    The part of a state is the square of its component; the parts of a direction sum to one.

    Args:
        path: The PNG to write.
        record: The record.
        outages: Between dashed lines.

    Returns:
        The path.
    """
    n = len(record.names)
    figure = new_figure(11.0, 1.6 + 0.21 * n)
    panels = figure.subplots(1, 2, sharey=True)
    # every time holds until the next one
    edges = np.append(
        record.t, record.t[-1] + np.median(np.diff(record.t, append=record.t[-1] + 1))
    )
    for axes, parts, title in zip(
        panels,
        (record.best**2, record.least**2),
        ("best observed direction", "least observed direction"),
        strict=True,
    ):
        drawn = axes.pcolormesh(
            edges, np.arange(n + 1), parts.T, cmap="Blues", vmin=0.0, vmax=1.0, rasterized=True
        )
        for outage in outages:
            for end in (outage.start, outage.end):
                axes.axvline(end, color=PALETTE[1], linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
        tidy(axes, "time (s)")
        axes.grid(visible=False)
        axes.set_title(title, color=INK, fontsize=10)
    panels[0].set_yticks(np.arange(n) + 0.5, [spoken(name) for name in record.names])
    panels[0].invert_yaxis()
    figure.colorbar(drawn, ax=panels, label="part of the direction", pad=0.01)
    return save(figure, path)


def state_groups(record: ObservabilityRecord) -> dict[str, list[int]]:
    """Return which states are drawn together: those of one unit.

    Args:
        record: The record.

    Returns:
        Indices of the states by a label of their panel.
    """
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(record.names):
        unit = record.units.get(name, "")
        label = {"": "variance", "1": "factors"}.get(unit, f"states in {unit}")
        groups.setdefault(label, []).append(i)
    return groups


def _curve(
    axes: "Axes", record: ObservabilityRecord, values: Array, color: str, label: str = "_"
) -> None:
    axes.plot(record.t, np.maximum(values, FLOOR), color=color, linewidth=1.3, label=label)


def _shade(axes: "Axes", record: ObservabilityRecord, outages: Sequence[Outage]) -> None:
    for outage in outages:
        axes.axvspan(outage.start, outage.end, color=OUTAGE, linewidth=0.0, zorder=0)
    for start, end in record.standstills():
        axes.axvspan(start, end, ymax=0.06, color=GREY, linewidth=0.0, zorder=0.5)


def _logarithmic(axes: "Axes") -> None:
    """Make the vertical axis logarithmic, a decade high at least: labels stand at decades."""
    from matplotlib.ticker import NullFormatter

    axes.set_yscale("log")
    axes.yaxis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    axes.set_ylim(10.0 ** min(np.floor(np.log10(low)), -1.0), 1.2 * max(high, 1.0))
