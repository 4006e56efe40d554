"""A long table of ranges as a row per reception and a slot per satellite."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.logs.interval_means import FloatArray
from navlearn.logs.range_checks import CONSTELLATIONS, is_satellite


@dataclass(frozen=True, kw_only=True)
class RangeOptions:
    """Which ranges are used.

    Attributes:
        systems: RINEX letters of the constellations used, such as ``GE``; None for all.
        least_elevation: Elevation below which a satellite is not used, rad.
        least_cn0: Carrier-to-noise density below which it is not used, dB-Hz.
        without: Satellites left out, such as ``("G07",)``.
        unknown_cn0: Carrier-to-noise density where the log tells none, dB-Hz.
    """

    systems: str | None = None
    least_elevation: float = math.radians(5.0)
    least_cn0: float = 0.0
    without: tuple[str, ...] = ()
    unknown_cn0: float = 45.0

    def __post_init__(self) -> None:
        """Refuse what has no meaning.

        Raises:
            ConfigError: A constellation or satellite has no such name, or a limit is none.
        """
        wrong = sorted(set(self.systems or "") - set(CONSTELLATIONS))
        if wrong or self.systems == "":
            raise ConfigError(
                f"systems: found {self.systems!r}; expected RINEX letters of {CONSTELLATIONS}, "
                "such as GE, or None for all"
            )
        unnamed = [name for name in self.without if not is_satellite(name)]
        if unnamed:
            raise ConfigError(f"without: found {unnamed[0]!r}; expected satellites such as G07")
        if not abs(self.least_elevation) < 0.5 * math.pi:
            raise ConfigError(
                f"least_elevation: found {self.least_elevation!r}; expected within ±90°, in rad"
            )
        for name in ("least_cn0", "unknown_cn0"):
            if not math.isfinite(getattr(self, name)):
                raise ConfigError(f"{name}: found {getattr(self, name)!r}; expected dB-Hz")


class DenseRanges(NamedTuple):
    """Receptions as dense tables.

    Attributes:
        t: Times of reception, s, shape (M,).
        columns: Columns of numbers, NaN where there is no row or no value, shape (M, S) each.
        heard: 1.0 where there is a row, shape (M, S).
    """

    t: FloatArray
    columns: dict[str, Tensor]
    heard: Tensor

    def triad(self, prefix: str) -> Tensor:
        """Return three columns as vectors, zero where there is none, shape (M, S, 3)."""
        axes = [self.columns.get(f"{prefix}{axis}", torch.zeros_like(self.heard)) for axis in "xyz"]
        return torch.stack(axes, dim=-1).nan_to_num(0.0)

    def told(self, name: str, unknown: float) -> Tensor:
        """Return a column, with a value where the log tells none, shape (M, S)."""
        values = self.columns.get(name)
        if values is None:
            return torch.full_like(self.heard, unknown)
        return values.nan_to_num(unknown)


def laid_out(
    table: pd.DataFrame, options: RangeOptions
) -> tuple[tuple[str, ...], tuple[str, ...], DenseRanges]:
    """Return satellites, systems, and the columns with a row per reception.

    Args:
        table: Columns of :data:`navlearn.logs.columns.RANGES`, checked.
        options: Which ranges are used.
    """
    name = table["satellite"].astype("str")
    wanted = ~name.isin(options.without)
    if options.systems is not None:
        wanted &= name.str[0].isin(list(options.systems))
    table, name = table[wanted], name[wanted]
    satellites = tuple(sorted(name.unique(), key=lambda text: (text[0], int(text[1:]))))
    rows = name.str[0].value_counts()
    systems = tuple(sorted(rows.index, key=lambda letter: (-int(rows[letter]), letter)))
    t, row = np.unique(table["t"].to_numpy(np.float64), return_inverse=True)
    slot = name.map({text: k for k, text in enumerate(satellites)}).to_numpy(np.int64)

    def spread(values: FloatArray) -> Tensor:
        cells = np.full((t.size, len(satellites)), np.nan)
        cells[row, slot] = values
        return torch.from_numpy(cells)

    columns = {
        str(column): spread(table[column].to_numpy(np.float64))
        for column in table
        if column not in ("t", "satellite")
    }
    heard = torch.zeros(t.size, len(satellites), dtype=torch.float64)
    heard[torch.tensor(row), torch.tensor(slot)] = 1.0
    return satellites, systems, DenseRanges(t, columns, heard)
