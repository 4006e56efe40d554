"""How a model fits what it learned from: residuals by part, and the path that it makes.

[Jaradat2017] shows error histograms, regressions and fused paths, and prints the *mean* of the
training residual. A least-squares model with a constant has a mean residual of zero on its
training rows whatever it predicts, so the root mean square stands beside it here, the same for
"nothing changes since the last row", and the rows that were not trained on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from navlearn.errors import ShapeError
from navlearn.outages.markdown import markdown_table
from navlearn.outages.track import Array

PARTS: Final = ("training", "validation", "test")

PREDECESSOR: Final = {"x": -1.03e-2, "y": 1.82e-2, "z": -2.04e-3}
"""Mean residual of the neuro-fuzzy predecessor on a real drive, m, [Jaradat2017] §V."""


@dataclass(frozen=True, kw_only=True)
class AxisDiagnostics:
    """Targets and predictions of one output.

    Attributes:
        axis: Its name, such as ``x``.
        target: Targets, m, shape (R,).
        predicted: Predictions in the loop of the training, m, shape (R,).
        unchanged: Targets one row earlier, m, shape (R,).
        part: Which of :data:`PARTS` each row belongs to; other words are not counted.
        at_fix: Where a fix was taken, shape (R,); None where rows are not those of fixes.
    """

    axis: str
    target: Array
    predicted: Array
    unchanged: Array
    part: NDArray[np.str_]
    at_fix: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        at_fix = () if self.at_fix is None else (self.at_fix.shape,)
        found = (self.predicted.shape, self.unchanged.shape, self.part.shape, *at_fix)
        if any(shape != self.target.shape for shape in found) or self.target.ndim != 1:
            raise ShapeError(
                f"diagnostics of {self.axis}: shapes {self.target.shape} and "
                f"{found}; expected a value of each per row"
            )


@dataclass(frozen=True, kw_only=True)
class FusedPath:
    """Positions over time, in the axes of the outputs, against a common origin, m.

    Attributes:
        t: Time, s, shape (T,).
        ins: Free-running INS, shape (T, 3).
        fused: The model's path, in closed loop, shape (T, 3).
        fix_t: Time of the fixes, s, shape (M,).
        fix: Fixes, shape (M, 3).
        truth: Truth or reference, shape (T, 3); None where there is none.
        origin: Position of that origin, m, shape (3,); None for zero.
    """

    t: Array
    ins: Array
    fused: Array
    fix_t: Array
    fix: Array
    truth: Array | None = None
    origin: Array | None = None


@dataclass(frozen=True, kw_only=True)
class FitDiagnostics:
    """One fit of one method.

    Attributes:
        method: Name of the method.
        loop: ``open`` or ``closed``: the loop of the training.
        split: ``random`` (neighbouring rows leak) or ``time``.
        axes: Its outputs.
        path: The path that it makes; None where it makes none of its own.
    """

    method: str
    loop: str
    split: str
    axes: tuple[AxisDiagnostics, ...]
    path: FusedPath | None = None

    def with_truth(self, t: Array, truth: Array) -> "FitDiagnostics":
        """Return the diagnostics with what the path is judged by.

        Args:
            t: Times of the truth, s, shape (N,).
            truth: Positions in the path's axes, not yet against its origin, m, shape (N, 3).
        """
        if self.path is None:
            return self
        from_origin = truth if self.path.origin is None else truth - self.path.origin
        at = np.stack([np.interp(self.path.t, t, column) for column in from_origin.T], -1)
        return replace(self, path=replace(self.path, truth=at))


def residual_table(diagnostics: Sequence[FitDiagnostics]) -> pd.DataFrame:
    """Return the residuals by method, axis, part and kind of row: ``fit_residuals.csv``.

    Args:
        diagnostics: One per method.

    Returns:
        Columns ``method``, ``loop``, ``axis``, ``part``, ``rows`` (``all``, ``at fixes``,
        ``between fixes``), ``count``, ``mean``, ``rms``, ``rms_unchanged`` (of predicting the
        target of the row before), all in m, and ``r``, the correlation with the target. For a
        path with a truth also rows of part ``in use`` and ``ins alone``: its error in closed
        loop and the INS's, at every time.
    """
    rows = [
        {"method": one.method, "loop": one.loop, "axis": axis.axis, "part": part, **found}
        for one in diagnostics
        for axis in one.axes
        for part in PARTS
        for found in _by_kind_of_row(axis, part)
    ]
    rows += [row for one in diagnostics for row in _in_use(one)]
    return pd.DataFrame(rows)


def _by_kind_of_row(axis: AxisDiagnostics, part: str) -> list[dict[str, object]]:
    mine = axis.part == part
    kinds = {"all": mine}
    if axis.at_fix is not None:
        kinds |= {"at fixes": mine & axis.at_fix, "between fixes": mine & ~axis.at_fix}
    return [{"rows": kind, **_figures(axis, rows)} for kind, rows in kinds.items() if rows.any()]


def _figures(axis: AxisDiagnostics, rows: NDArray[np.bool_]) -> dict[str, object]:
    target, predicted = axis.target[rows], axis.predicted[rows]
    residual = predicted - target
    unchanged = axis.unchanged[rows] - target
    return {
        "count": int(rows.sum()),
        "mean": float(residual.mean()),
        "rms": float(np.sqrt(np.mean(residual**2))),
        "rms_unchanged": float(np.sqrt(np.mean(unchanged**2))),
        "r": correlation(target, predicted),
    }


def correlation(one: Array, two: Array) -> float:
    """Return the correlation of two records, NaN where one of them never moves or is not finite.

    Args:
        one: Shape (R,).
        two: Shape (R,).
    """
    moves = one.size > 2 and np.ptp(one) > 0.0 and np.ptp(two) > 0.0
    return float(np.corrcoef(one, two)[0, 1]) if moves and np.isfinite(one @ two) else float("nan")


def _in_use(one: FitDiagnostics) -> list[dict[str, object]]:
    if one.path is None or one.path.truth is None:
        return []
    found = []
    for part, path in (("in use", one.path.fused), ("ins alone", one.path.ins)):
        error = path - one.path.truth
        for axis, column in zip(one.axes, error.T, strict=True):
            about = {"method": one.method, "loop": one.loop, "axis": axis.axis, "part": part}
            figures = {"mean": float(column.mean()), "rms": float(np.sqrt(np.mean(column**2)))}
            found.append({**about, "rows": "all", "count": column.size, **figures})
    return found


def fit_section(diagnostics: Sequence[FitDiagnostics]) -> list[str]:
    """Return what a report says of the fits, as Markdown, a heading first.

    Args:
        diagnostics: One per method, of the last outage each.
    """
    table = residual_table(diagnostics)
    every = table[table["rows"] == "all"]
    lines = [
        (
            str(row["method"]),
            str(row["axis"]),
            str(row["part"]),
            str(row["count"]),
            f"{row['mean']:+.2e}",
            _figure(row["rms"], ".4g"),
            _figure(row.get("rms_unchanged"), ".4g"),
            _figure(row.get("r"), ".5f"),
        )
        for row in every.to_dict("records")
    ]
    header = ("method", "output", "part", "rows", "mean m", "RMS m", "RMS if unchanged m", "R")
    out = [
        "## What networks make of what they learned from\n",
        "The last fit of each, before the last outage.\n",
        markdown_table(header, lines, texts=3),
        "The mean residual is next to zero on training rows for any least-squares model with a "
        "constant, whatever it predicts: judge by the RMS, by what the row before would have "
        "told (*if unchanged*), and by how the model does in use.\n",
    ]
    if (every["part"] == "in use").any():
        out.append(
            "\n*In use* is the error of the path against the reference at every step, the networks "
            "run on their own output over the rows that they learned from and through the outage; "
            "*ins alone* is that of the INS without them.\n"
        )
    leaking = [f"`{one.method}`" for one in diagnostics if one.split == "random"]
    if leaking:
        out.append(
            f"\nRows of {', '.join(leaking)} are split at random, as in [Jaradat2017]: each test "
            "row has training rows beside it, so its test figures are training figures.\n"
        )
    if any(axis.axis in PREDECESSOR for one in diagnostics for axis in one.axes):
        told = ", ".join(f"{value:.2e} ({axis})" for axis, value in PREDECESSOR.items())
        out.append(
            f"\n[Jaradat2017] prints means of the residual alone: {told} m for its neuro-fuzzy "
            "predecessor, some 1e-6 m for itself, both on a drive that is not available.\n"
        )
    return out


def _figure(value: float | None, form: str) -> str:
    """Return a figure, or nothing where there is none."""
    return "" if value is None or not np.isfinite(value) else format(value, form)
