"""The cells of a sweep: one class of gyros, one length of outages, one number of satellites."""

from collections.abc import Hashable, Iterator, Mapping
from typing import Any, NamedTuple

import pandas as pd

from navlearn.outages.naming import counted

KEYS = ("gyro_class", "duration_s", "satellites")
"""Columns whose values tell cells apart."""


class Cell(NamedTuple):
    """What the outages of a cell have in common.

    Attributes:
        gyro_class: Name of the class of gyros.
        duration: Length of the outages, s.
        satellites: How many satellites' ranges stay.
    """

    gyro_class: str
    duration: float
    satellites: int


def cell_of(line: "Mapping[Hashable, Any] | pd.Series[Any]") -> Cell:
    """Return the cell of a row of outages, or of a line of a sweep's table.

    Args:
        line: Values by the names of the columns.
    """
    gyro_class, duration, satellites = (line[name] for name in KEYS)
    return Cell(str(gyro_class), float(duration), int(satellites))


def cells_of(rows: pd.DataFrame) -> Iterator[tuple[Cell, pd.DataFrame]]:
    """Yield each cell with its rows, in the order of the rows.

    Args:
        rows: Tables of outages of all cells, or lines of a sweep's table.
    """
    for _, part in rows.groupby(list(KEYS), sort=False):
        yield cell_of(part.iloc[0]), part


def are_partial(rows: pd.DataFrame) -> bool:
    """Return whether satellites stay through any of some outages.

    Args:
        rows: Tables of outages, or lines of a sweep's table.
    """
    return bool((rows["satellites"] > 0).any())


def conditions(rows: pd.DataFrame) -> dict[Cell, str]:
    """Return what the outages of each cell are in words, such as ``60 s, 3 satellites``.

    Args:
        rows: Tables of outages of all cells, or lines of a sweep's table; where satellites stay
            in none of them, their number is not told.
    """
    partial = are_partial(rows)
    return {
        cell: f"{cell.duration:g} s" + (f", {with_satellites(cell.satellites)}" if partial else "")
        for cell, _ in cells_of(rows)
    }


def with_satellites(satellites: int) -> str:
    """Return how many satellites stay in words.

    Args:
        satellites: How many.
    """
    return counted(satellites, "satellite") if satellites else "no satellite"
