"""Finding and opening the MATLAB files of a NavINST drive."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.interval_means import FloatArray


def find_one(folder: Path, name: str) -> Path | None:
    """Return the only file of a name in or below a folder, or None.

    Args:
        folder: Folder to look in.
        name: Name of the file.

    Raises:
        LogError: There are several: several drives.
    """
    found = sorted(folder.rglob(name))
    if len(found) > 1:
        raise LogError(
            f"{folder}: {len(found)} drives below it ({found[0].parent}, {found[1].parent}); name "
            "the folder of one"
        )
    return found[0] if found else None


def load_variables(path: Path) -> dict[str, object]:
    """Return the variables of a MATLAB file by name.

    Args:
        path: File.

    Raises:
        LogError: It is not readable.
    """
    import scipy.io

    try:
        variables: dict[str, object] = scipy.io.loadmat(path, squeeze_me=False)
    except Exception as error:
        # A damaged file makes SciPy fail in many ways, private classes among them.
        raise LogError(
            f"{path.name}: not readable as a MATLAB 5 file ({path.stat().st_size} bytes; {error}); "
            "it is truncated or damaged: fetch it again"
        ) from error
    return variables


def variable(path: Path, variables: Mapping[str, object], name: str) -> object:
    """Return a variable.

    Args:
        path: File, for messages.
        variables: What it holds.
        name: Name of the variable.

    Raises:
        LogError: There is none of this name.
    """
    if name not in variables:
        found = ", ".join(key for key in variables if not key.startswith("__")) or "nothing"
        raise LogError(
            f"{path.name}: no variable {name}; found {found}; a file cut short loses its last "
            "variables: fetch it again"
        )
    return variables[name]


def vector(path: Path, variables: Mapping[str, object], name: str) -> FloatArray:
    """Return a variable as a vector of numbers.

    Args:
        path: File, for messages.
        variables: What it holds.
        name: Name of the variable.

    Raises:
        LogError: There is none of this name, or it holds something else.
    """
    found = variable(path, variables, name)
    try:
        return np.asarray(found, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise LogError(f"{path.name}: variable {name} is not numbers ({error})") from error


def table_of(path: Path, columns: Mapping[str, FloatArray]) -> pd.DataFrame:
    """Return vectors of one length as a table.

    Args:
        path: File, for messages.
        columns: Vectors by name.

    Raises:
        LogError: They differ in length.
    """
    lengths = {name: values.size for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise LogError(f"{path.name}: variables differ in length: {lengths}; fetch the file again")
    return pd.DataFrame(dict(columns))
