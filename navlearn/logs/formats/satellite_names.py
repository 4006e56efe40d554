"""Names of satellites from the columns of plain tables."""

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.nearest import nearest_hint
from navlearn.logs.table_layout import SatelliteName


def satellite_names(file: str, column: pd.Series) -> pd.Series:
    """Return a column of names such as ``G07`` as text.

    Args:
        file: File, for messages.
        column: The column.

    Raises:
        LogError: It holds numbers: the constellation is not told.
    """
    if pd.api.types.is_numeric_dtype(column) and len(column):
        raise LogError(
            f"{file}: column {column.name} holds numbers ({column.iloc[0]:g}), which leave the "
            "constellation open; write names such as G07, or give the table's satellite: "
            "{constellation: COLUMN, number: COLUMN} in a descriptor"
        )
    return column.astype("str").str.strip()


def joined_names(file: str, frame: pd.DataFrame, name: SatelliteName) -> pd.Series:
    """Return names made of a column of RINEX letters and one of numbers.

    Args:
        file: File, for messages.
        frame: What the file holds.
        name: Its columns.

    Raises:
        LogError: A column is missing, or a number is none.
    """
    for column in (name.constellation, name.number):
        if column not in frame:
            raise LogError(
                f"{file}: no column {column}{nearest_hint(column, map(str, frame.columns))}, which "
                "the descriptor names for satellite; found "
                f"{', '.join(map(str, frame.columns))}"
            )
    number = pd.to_numeric(frame[name.number], errors="coerce").to_numpy(np.float64)
    wrong = ~(np.isfinite(number) & (number == np.rint(number)) & (number > 0.0))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{file}: column {name.number} holds {frame[name.number].iloc[row]!r} at row "
            f"{row + 1}, expected the number of a satellite"
        )
    letters = frame[name.constellation].astype("str").str.strip()
    numbers = pd.Series([f"{int(value):02d}" for value in number], index=frame.index, dtype="str")
    return letters + numbers
