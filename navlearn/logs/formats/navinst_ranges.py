"""Raw GPS ranges of a NavINST drive: MATLAB cells, one per second.

``Raw_Data_combined.mat`` holds C/A pseudoranges, L1 Doppler, satellites and the corrections that
its authors computed; ``GPS_Data_Combined_Nova.mat`` carrier-to-noise densities of the same
receptions; ``IONUTC.mat`` the ionosphere as broadcast. Measured on the Kingston drive: what leaves
the receiver's clock alone is ``Rho_GPS + Sat_Clk_Corr − Sat_Ion_Corr − Sat_Tro_Corr`` with
satellites ``Sat_X``, ``Sat_Y``, ``Sat_Z``, which are in the axes of the moment of reception
(``Sat_X_Eph`` and its like are in those of sending). ``Sat_Ion_Corr`` is made of both frequencies:
it also holds the receiver's own delay between them, hence its sign.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from navlearn.errors import LogError
from navlearn.gnss import signals
from navlearn.gnss.gnss_time import WEEK
from navlearn.logs.formats.navinst_files import find_one, load_variables, variable, vector
from navlearn.logs.interval_means import FloatArray

IntArray = npt.NDArray[np.int64]

RAW: Final = "Raw_Data_combined.mat"
RECEIVER: Final = "GPS_Data_Combined_Nova.mat"
IONOSPHERE: Final = "IONUTC.mat"

LAST_GPS: Final = 32
"""Largest number of a GPS satellite."""

_COLUMNS: Final = {
    "pseudorange": ("Rho_GPS", 1.0),
    "range_rate": ("Dopp_GPS", -signals.SPEED_OF_LIGHT / signals.L1),
    "std_range": ("Rho_GPS_std", 1.0),
    "sat_x": ("Sat_X", 1.0),
    "sat_y": ("Sat_Y", 1.0),
    "sat_z": ("Sat_Z", 1.0),
    "sat_vx": ("Sat_VX", 1.0),
    "sat_vy": ("Sat_VY", 1.0),
    "sat_vz": ("Sat_VZ", 1.0),
    "sat_clock": ("Sat_Clk_Corr", 1.0),
    "ionosphere": ("Sat_Ion_Corr", 1.0),
    "troposphere": ("Sat_Tro_Corr", 1.0),
}


class NavinstRanges(NamedTuple):
    """Ranges of a NavINST drive.

    Attributes:
        table: Columns of :data:`navlearn.logs.columns.RANGES`, t in seconds of the first week.
        path: File that they came from.
        corrections: What has already been done to them.
        klobuchar: Ionosphere as broadcast; empty where its file is missing.
        gps_time_origin: Begin of the week that t counts from, GPS seconds.
    """

    table: pd.DataFrame
    path: Path
    corrections: tuple[str, ...]
    klobuchar: tuple[float, ...]
    gps_time_origin: float


def read_navinst_ranges(folder: Path) -> NavinstRanges | None:
    """Return the raw ranges of a NavINST drive, or None where it has none.

    Args:
        folder: A folder at or above the drive's.

    Raises:
        LogError: A file is damaged, a variable is missing, or cells disagree in length.
    """
    path = find_one(folder, RAW)
    if path is None:
        return None
    variables = load_variables(path)
    found = _receptions(path, variables, "Sat_Num", "RAW_second", "RAW_week")
    columns: dict[str, object] = {"t": found.t, "satellite": found.satellite}
    for column, (name, factor) in _COLUMNS.items():
        columns[column] = factor * _as_many(path, variables, name, found.sizes)
    table = pd.DataFrame(columns)
    cn0 = _densities(folder, found.week)
    if cn0 is not None:
        table = table.merge(cn0, on=["t", "satellite"], how="left")
    origin = WEEK * found.week
    return NavinstRanges(table, path, ("earth_rotation",), _klobuchar(folder), origin)


class _Receptions(NamedTuple):
    t: FloatArray
    satellite: list[str]
    sizes: IntArray
    week: float


def _receptions(
    path: Path,
    variables: Mapping[str, object],
    numbers: str,
    seconds: str,
    weeks: str,
    first: float | None = None,
) -> _Receptions:
    """Return time and satellite of every range, and how many each reception has."""
    count, number = _cells(path, variables, numbers)
    second, week = vector(path, variables, seconds), vector(path, variables, weeks)
    if not second.size == week.size == count.size or second.size == 0:
        raise LogError(
            f"{path.name}: {second.size} times and {week.size} weeks for {count.size} receptions; "
            "fetch the file again"
        )
    origin = float(week[0]) if first is None else first
    t = np.repeat(second + WEEK * (week - origin), count)
    return _Receptions(t, _names(path, number), count, origin)


def _cells(path: Path, variables: Mapping[str, object], name: str) -> tuple[IntArray, FloatArray]:
    """Return how many values each cell of a variable holds, and all values in a row."""
    cells = np.asarray(variable(path, variables, name))
    if cells.dtype != object:
        raise LogError(f"{path.name}: variable {name} is no row of cells, one per reception")
    try:
        values = [np.asarray(cell, dtype=np.float64).ravel() for cell in cells.ravel()]
    except (TypeError, ValueError) as error:
        raise LogError(f"{path.name}: variable {name} is not numbers ({error})") from error
    count = np.array([value.size for value in values], dtype=np.int64)
    return count, np.concatenate(values) if values else np.zeros(0)


def _as_many(
    path: Path,
    variables: Mapping[str, object],
    name: str,
    count: IntArray,
) -> FloatArray:
    own, values = _cells(path, variables, name)
    if own.size != count.size or (own != count).any():
        wrong = (
            int(np.argmax(own != count)) if own.size == count.size else min(own.size, count.size)
        )
        raise LogError(
            f"{path.name}: {name} does not hold a value for each satellite of Sat_Num (first in "
            f"cell {wrong + 1}); fetch the file again"
        )
    return values


def _names(path: Path, number: FloatArray) -> list[str]:
    wrong = ~((number >= 1.0) & (number <= LAST_GPS) & (number == np.rint(number)))
    if wrong.any():
        raise LogError(
            f"{path.name}: satellite {number[int(np.argmax(wrong))]:g} is no GPS satellite (1 to "
            f"{LAST_GPS}); the ranges of this laboratory are GPS alone"
        )
    return [f"G{int(value):02d}" for value in number]


def _densities(folder: Path, week: float) -> pd.DataFrame | None:
    path = find_one(folder, RECEIVER)
    if path is None:
        return None
    variables = load_variables(path)
    found = _receptions(path, variables, "sv_no", "GPS_sec", "GPS_week", week)
    cn0 = _as_many(path, variables, "c_2_n_L1", found.sizes)
    table = pd.DataFrame({"t": found.t, "satellite": found.satellite, "cn0": cn0})
    return table.drop_duplicates(["t", "satellite"])


def _klobuchar(folder: Path) -> tuple[float, ...]:
    path = find_one(folder, IONOSPHERE)
    if path is None:
        return ()
    variables = load_variables(path)
    names = [f"{letter}{power}" for letter in "ab" for power in range(4)]
    told = [vector(path, variables, name) for name in names]
    if any(values.size == 0 for values in told):
        raise LogError(f"{path.name}: {', '.join(names)} hold no values; fetch the file again")
    return tuple(float(values[0]) for values in told)
