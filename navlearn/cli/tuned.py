"""What is shown of a tuning."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from navlearn.experiment.tuning import TuningResult
    from navlearn.learning.noise_figures import ParameterFigure


def show_tuned(result: "TuningResult", out: Path) -> None:
    """Print a table of what was tuned, what it gains on held-out data, and where the spec is.

    Args:
        result: The tuning.
        out: The spec's file.
    """
    if result.figures is not None:
        _show_figures((*result.figures.entries, *result.figures.fixes))
    else:
        _show_values(result.spec.filter)
    for note in result.spec.notes:
        typer.echo(note)
    typer.echo(f"Took {result.wall:.0f} s. Spec: {out}")


def _show_figures(figures: "tuple[ParameterFigure, ...]") -> None:
    rows = [("entry", "unit", "before", "after", "95 % interval", "told")]
    for one in figures:
        low, high = one.interval
        rows.append(
            (
                one.name,
                one.unit,
                f"{one.before:.3g}",
                f"{one.after:.3g}",
                f"{low:.3g} to {high:.3g}",
                "yes" if one.told else "no",
            )
        )
    _show(rows)


def _show_values(options: Mapping[str, Any]) -> None:
    _show([("entry", "found"), *_flat(options)])


def _flat(options: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for name, value in options.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{name}.")
        else:
            told = f"{value:.3g}" if isinstance(value, float) and math.isfinite(value) else value
            rows.append((prefix + name, str(told)))
    return rows


def _show(rows: list[Any]) -> None:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        typer.echo("  ".join(cells).rstrip())
    typer.echo()
