"""Tables of RMS errors by state, a column per solution, as [Ghouneem2024] prints them."""

import math
from collections.abc import Callable

import pandas as pd

from navlearn.outages.markdown import markdown_table, number, signed
from navlearn.outages.state_errors import FIGURES, STATES, horizontal_figures, state_rmse


def rmse_table(rmse: pd.DataFrame) -> str:
    """Return RMS errors as a Markdown table: states down, solutions across.

    Args:
        rmse: As :func:`navlearn.outages.state_errors.state_rmse` returns it.
    """
    return _table(rmse, ("rmse", "low", "high"), _with_interval)


def gain_table(rmse: pd.DataFrame) -> str:
    """Return gains over the baseline as a Markdown table, in percent of its RMS error.

    Args:
        rmse: As :func:`navlearn.outages.state_errors.state_rmse` returns it.
    """
    return _table(rmse, ("gain_percent", "gain_low", "gain_high"), _signed_interval, "%")


def horizontal_table(figures: pd.DataFrame) -> str:
    """Return figures of the horizontal error as a Markdown table: figures down, solutions across.

    Args:
        figures: As :func:`navlearn.outages.state_errors.horizontal_figures` returns them.
    """
    lines = [[name, "m", *(number(value) for value in figures[name])] for name in FIGURES]
    return markdown_table(["horizontal error", "unit", *figures.index], lines, texts=2)


def _table(
    rmse: pd.DataFrame,
    columns: tuple[str, str, str],
    cell: Callable[[float, float, float], str],
    unit: str = "",
) -> str:
    names = list(dict.fromkeys(rmse["solution"]))
    by_name = rmse.set_index(["state", "solution"])
    lines = [
        [state, unit or own, *(cell(*(by_name.loc[(state, n), list(columns)])) for n in names)]
        for state, own in STATES.items()
    ]
    return markdown_table(["RMS error" if not unit else "gain", "unit", *names], lines, texts=2)


def _with_interval(value: float, low: float, high: float) -> str:
    digits = 2 if value < 10.0 else 1
    said = number(value, digits)
    return said if math.isnan(low) else f"{said} ({number(low, digits)} to {number(high, digits)})"


def _signed_interval(value: float, low: float, high: float) -> str:
    said = signed(value)
    return said if math.isnan(low) else f"{said} ({signed(low)} to {signed(high)})"


def state_report(errors: pd.DataFrame, baseline: str) -> str:
    """Return all tables of some drives, with what they were counted from.

    Args:
        errors: Rows of :func:`navlearn.outages.state_errors.judged_together`, with ``drive``.
        baseline: Solution that gains are counted from.
    """
    rmse = state_rmse(errors, baseline)
    mine = errors[errors["solution"] == baseline]
    drives = mine["drive"].nunique()
    parts = [
        f"{drives} drive{'s' if drives > 1 else ''}, {len(mine)} times of the reference; "
        "intervals are of 95 %, drawn by drive",
        rmse_table(rmse),
        horizontal_table(horizontal_figures(errors)),
        f"By how much the RMS error is smaller than that of `{baseline}`:",
        gain_table(rmse[rmse["solution"] != baseline]),
    ]
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"
