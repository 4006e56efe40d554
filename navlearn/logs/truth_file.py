"""Tables of what only a simulation knows, one file each beside a log."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.formats.csv_tables import read_frame


def write_truth(table: pd.DataFrame, path: Path) -> Path:
    """Write a table; the same values give the same bytes, and come back to the last bit.

    Args:
        table: What is known.
        path: File, replaced where it is there.

    Returns:
        The file.
    """
    compression = {"method": "gzip", "mtime": 0, "compresslevel": 6}
    table.to_csv(path, index=False, float_format="%.17g", compression=compression)
    return path


def read_truth(path: Path, columns: Collection[str], remedy: str, texts: str = "") -> pd.DataFrame:
    """Read a table that :func:`write_truth` wrote.

    Args:
        path: File.
        columns: Columns that it must have.
        remedy: What a user does who has no such file.
        texts: The column that holds text, if any; all others are finite numbers.

    Returns:
        These columns, in this order.

    Raises:
        LogNotFoundError: There is no such file.
        LogError: A column is missing or holds something else.
    """
    if not path.is_file():
        raise LogNotFoundError(f"{path.parent}: no {path.name}: {remedy}")
    table = read_frame(path)
    missing = [name for name in columns if name not in table]
    if missing:
        raise LogError(f"{path}: no column {', '.join(missing)}; simulate the drive again")
    numbers = [name for name in columns if name != texts]
    try:
        values = table[numbers].astype(np.float64)
    except ValueError as error:
        raise LogError(f"{path}: not all numbers ({error}); simulate the drive again") from error
    if not np.isfinite(values.to_numpy()).all():
        raise LogError(f"{path}: values that are not finite; simulate the drive again")
    if texts:
        values = values.assign(**{texts: table[texts].astype(str)})
    return values[list(columns)]
