"""Figures of a fit as [Jaradat2017] shows them: histogram, regression, fused path."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navlearn.errors import ConfigError
from navlearn.outages.canvas import (
    FIX,
    INK,
    PALETTE,
    REFERENCE,
    new_figure,
    plots_possible,
    save,
    tidy,
)
from navlearn.outages.fit_diagnostics import (
    PARTS,
    AxisDiagnostics,
    FitDiagnostics,
    correlation,
    residual_table,
)
from navlearn.outages.output import OutputFolder
from navlearn.outages.track import Array

BINS = 41
MOST_POINTS = 4000
"""Of a cloud, so that a figure of an hour at 50 Hz stays a figure."""


def write_fit_diagnostics(
    output: OutputFolder, diagnostics: Sequence[FitDiagnostics]
) -> dict[str, str]:
    """Write ``fit_residuals.csv`` and, where matplotlib is there, the figures of each method.

    Args:
        output: The run's folder.
        diagnostics: One per method.

    Returns:
        Captions of the figures by file name.
    """
    table = residual_table(diagnostics)
    table.to_csv(output.claim("fit_residuals.csv"), index=False)
    captions: dict[str, str] = {}
    for one in diagnostics if plots_possible() else ():
        name = f"fit_{one.method}"
        plot_error_histogram(output.claim(f"{name}_histogram.png"), one)
        plot_regression(output.claim(f"{name}_regression.png"), one)
        captions[f"{name}_histogram.png"] = (
            f"Residuals of `{one.method}` on what it learned from before the last outage; what "
            "lies beyond the outermost half per cent is drawn at the edge."
        )
        captions[f"{name}_regression.png"] = (
            f"Predictions of `{one.method}` over targets, by part of the data."
        )
        if one.path is not None:
            plot_fused_path(output.claim(f"{name}_path.png"), one)
            captions[f"{name}_path.png"] = (
                f"INS alone, fixes and the path of `{one.method}` run on its own output, from a "
                "common origin (left), and their errors (right)."
            )
    return captions


def plot_error_histogram(path: Path, one: FitDiagnostics) -> Path:
    """Draw how residuals are distributed, by output and part.

    Args:
        path: The PNG to write.
        one: The fit.

    Returns:
        The path.
    """
    figure = new_figure(4.0 * len(one.axes), 3.6)
    for axes, axis in zip(
        figure.subplots(1, len(one.axes), squeeze=False)[0], one.axes, strict=True
    ):
        residual = axis.predicted - axis.target
        counted = np.isin(axis.part, PARTS) & np.isfinite(residual)
        if counted.any():
            low, high = np.percentile(residual[counted], [0.5, 99.5])
            edges = np.linspace(low, max(high, low + 1e-12), BINS)
            groups = [np.clip(residual[counted & (axis.part == p)], low, high) for p in PARTS]
            axes.hist(groups, edges, stacked=True, color=list(PALETTE[: len(PARTS)]), label=PARTS)
            mean, rms = residual[counted].mean(), np.sqrt(np.mean(residual[counted] ** 2))
            axes.set_title(f"{axis.axis}: mean {mean:.1e} m, RMS {rms:.2g} m", color=INK, size=10)
        axes.axvline(0.0, color=REFERENCE, linewidth=1.0)
        tidy(axes, "prediction − target (m)", "rows")
    figure.axes[0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{one.method}: residuals, {one.loop} loop, {one.split} split", color=INK)
    return save(figure, path)


def plot_regression(path: Path, one: FitDiagnostics) -> Path:
    """Draw predictions over targets, a row of panels per output, a panel per part and one of all.

    Args:
        path: The PNG to write.
        one: The fit.

    Returns:
        The path.
    """
    figure = new_figure(11.0, 2.9 * len(one.axes))
    panels = figure.subplots(len(one.axes), len(PARTS) + 1, squeeze=False)
    for row, axis in zip(panels, one.axes, strict=True):
        for axes, part in zip(row, (*PARTS, "all"), strict=True):
            rows = np.isin(axis.part, PARTS) if part == "all" else axis.part == part
            rows = rows & np.isfinite(axis.predicted)
            target, predicted = _thinned(axis, rows)
            if target.size > 2:
                ends = [float(target.min()), float(target.max())]
                axes.plot(ends, ends, color=FIX, linewidth=1.5)
                axes.plot(target, predicted, ".", color=PALETTE[0], markersize=2.0, alpha=0.5)
                r = correlation(axis.target[rows], axis.predicted[rows])
                axes.set_title(f"{axis.axis}, {part}: R = {r:.5f}", color=INK, size=9)
            tidy(axes, "target (m)", "prediction (m)" if part == PARTS[0] else "")
    figure.suptitle(f"{one.method}: regression, {one.loop} loop", color=INK)
    return save(figure, path)


def _thinned(axis: AxisDiagnostics, rows: NDArray[np.bool_]) -> tuple[Array, Array]:
    target, predicted = axis.target[rows], axis.predicted[rows]
    step = max(1, -(-target.size // MOST_POINTS))
    return target[::step], predicted[::step]


def plot_fused_path(path: Path, one: FitDiagnostics) -> Path:
    """Draw INS, fixes, fused path and truth over time, and their errors where there is a truth.

    Args:
        path: The PNG to write.
        one: The fit.

    Returns:
        The path.

    Raises:
        ConfigError: The fit has no path.
    """
    shown = one.path
    if shown is None:
        raise ConfigError(f"{one.method}: there is no path to draw; give its diagnostics one")
    figure = new_figure(11.0, 2.7 * len(one.axes))
    panels = figure.subplots(len(one.axes), 2, squeeze=False, sharex=True)
    for k, (axis, (left, right)) in enumerate(zip(one.axes, panels, strict=True)):
        left.plot(shown.fix_t, shown.fix[:, k], ".", color=FIX, markersize=3.0, label="GNSS")
        left.plot(shown.t, shown.ins[:, k], color=PALETTE[1], linewidth=1.5, label="INS")
        left.plot(shown.t, shown.fused[:, k], color=PALETTE[0], linewidth=1.5, label="fused")
        base = shown.fused[:, k] if shown.truth is None else shown.truth[:, k]
        if shown.truth is not None:
            left.plot(shown.t, base, color=REFERENCE, linewidth=0.9, label="truth")
        against = "fused path" if shown.truth is None else "truth"
        right.plot(
            shown.fix_t,
            shown.fix[:, k] - np.interp(shown.fix_t, shown.t, base),
            ".",
            color=FIX,
            markersize=3.0,
        )
        right.plot(shown.t, shown.ins[:, k] - base, color=PALETTE[1], linewidth=1.2)
        right.plot(shown.t, shown.fused[:, k] - base, color=PALETTE[0], linewidth=1.2)
        tidy(left, "time (s)", f"{axis.axis} (m)")
        tidy(right, "time (s)", f"{axis.axis} less {against} (m)")
    panels[0, 0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{one.method}: fused path, closed loop in use", color=INK)
    return save(figure, path)
