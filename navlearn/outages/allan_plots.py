"""The Allan deviation of an IMU at rest, with what was read off it."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from navlearn.logs.allan.standstill_noise import AxisNoise, StandstillNoise
from navlearn.logs.allan.terms import FLAT, Term
from navlearn.outages.canvas import INK, PALETTE, new_figure, save, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

UNITS = {"gyro": ("°/h", math.degrees(3600.0)), "accel": ("mg", 1e3 / 9.80665)}
"""Unit in which the Allan deviation of a sensor is shown, and how many make an SI unit."""

PER_ROOT_HOUR = {"gyro": ("°/√h", math.degrees(60.0)), "accel": ("m/s/√h", 60.0)}
"""The same of its white noise."""

WALKS = {"gyro": ("°/h/√h", math.degrees(3600.0) * 60.0), "accel": ("mg/√h", 60e3 / 9.80665)}
"""The same of its random walk."""


def plot_allan(path: Path, found: StandstillNoise) -> Path:
    """Draw the Allan deviation of every axis with its interval, gyros beside accelerometers.

    Thin lines are the white noise and the random walk that were read off.

    Args:
        path: The PNG to write.
        found: Noise of an IMU at rest.

    Returns:
        The path.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    kinds = [kind for kind in UNITS if any(one.axis.startswith(kind) for one in found.axes)]
    figure = new_figure(5.6 * len(kinds), 4.2)
    panels = figure.subplots(1, len(kinds), squeeze=False)[0]
    for axes, kind in zip(panels, kinds, strict=True):
        for color, one in zip(PALETTE, _of(found, kind), strict=False):
            _draw(axes, one, color, UNITS[kind][1])
        axes.set_xscale("log")
        axes.set_yscale("log")
        tidy(axes, "averaging time (s)", f"Allan deviation ({UNITS[kind][0]})")
        axes.legend(frameon=False, fontsize=9)
        axes.set_title(f"{found.log}, {found.stretch.length:.0f} s at rest", color=INK, fontsize=10)
    return save(figure, path)


def allan_table(found: StandstillNoise) -> pd.DataFrame:
    """Return what was read off, one row per axis and coefficient, in the units of data sheets.

    Args:
        found: Noise of an IMU at rest.

    Returns:
        Columns ``axis``, ``coefficient``, ``value`` (NaN where not shown), ``low``, ``high``,
        ``unit``, ``tau_s``.
    """
    rows = []
    for one in found.axes:
        kind = "gyro" if one.is_gyro else "accel"
        terms = one.terms
        for name, term, (unit, factor) in (
            ("random walk", terms.white, PER_ROOT_HOUR[kind]),
            ("bias instability", terms.instability, UNITS[kind]),
            ("bias random walk", terms.walk, WALKS[kind]),
        ):
            rows.append(
                {
                    "axis": one.axis,
                    "coefficient": name,
                    "value": term.value * factor,
                    "low": term.low * factor,
                    "high": term.high * factor,
                    "unit": unit,
                    "tau_s": term.tau,
                }
            )
    return pd.DataFrame(rows)


def curve_table(found: StandstillNoise) -> pd.DataFrame:
    """Return the Allan deviations, one row per axis and averaging time, SI.

    Args:
        found: Noise of an IMU at rest.
    """
    parts = [
        pd.DataFrame(
            {
                "axis": one.axis,
                "tau_s": one.curve.tau,
                "deviation": one.curve.deviation,
                "low": one.curve.low,
                "high": one.curve.high,
                "degrees_of_freedom": one.curve.freedom,
            }
        )
        for one in found.axes
    ]
    return pd.concat(parts, ignore_index=True)


def _of(found: StandstillNoise, kind: str) -> list[AxisNoise]:
    return [one for one in found.axes if one.axis.startswith(kind)]


def _draw(axes: "Axes", one: AxisNoise, color: str, factor: float) -> None:
    curve, terms = one.curve, one.terms
    axes.fill_between(
        curve.tau, curve.low * factor, curve.high * factor, color=color, alpha=0.2, linewidth=0.0
    )
    axes.plot(curve.tau, curve.deviation * factor, color=color, linewidth=1.6, label=one.axis)
    lines = (
        (terms.white, 1.0 / np.sqrt(curve.tau)),
        (terms.instability, np.full_like(curve.tau, math.sqrt(FLAT))),
        (terms.walk, np.sqrt(curve.tau / 3.0)),
    )
    lowest = float(curve.low.min()) * factor
    for term, shape in lines:
        _line(axes, term, curve.tau, shape * factor, color, lowest)


def _line(
    axes: "Axes", term: Term, tau: np.ndarray, shape: np.ndarray, color: str, lowest: float
) -> None:
    if not term.shown:
        return
    drawn = term.value * shape
    seen = drawn > 0.7 * lowest
    axes.plot(tau[seen], drawn[seen], color=color, linewidth=0.8, linestyle=":")
