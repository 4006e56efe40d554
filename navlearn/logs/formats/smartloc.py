"""Drives of the smartLoc data set: text records, one per line.

[Reisdorf2016] and the ``readme.txt`` beside the data. ``…_Input.txt`` holds ``odom3`` (speed and
yaw rate of the car's own sensors) and ``pseudorange3`` or ``range3`` (raw ranges), ``…_GT.txt``
holds ``point3`` (ground truth, Earth-fixed). Both variants, with the receiver's own and with
RTKLIB's satellites, are read alike: satellite clocks and atmosphere have been taken off, but
satellites stand in the axes of the moment of sending. There is no GPS time, no Doppler, no
accelerometer and no fix.
"""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import torch

from navlearn import frames
from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.assemble import Published
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.formats.finding import listing
from navlearn.logs.interval_means import FloatArray

INPUT: Final = "_Input.txt"
TRUTH: Final = "_GT.txt"

NUMBERS: Final = {"odom3": 13, "pseudorange3": 10, "range3": 10, "point3": 13}
"""How many numbers follow the name of each record; others are passed over."""

SYSTEMS: Final = {1: "G", 2: "S", 4: "R", 8: "E", 16: "J", 32: "C"}
"""RINEX letter of each system's number."""

_RANGES: Final = ("pseudorange3", "range3")


def read_smartloc(path: Path, descriptor: Descriptor) -> Published:
    """Return the tables of a smartLoc drive.

    Args:
        path: The drive's ``…_Input.txt``, or a folder at or above it.
        descriptor: Not asked here; the same for every format.

    Returns:
        IMU (yaw rate alone), odometer, ranges and, where the ground truth is beside, reference.

    Raises:
        LogNotFoundError: There is no such file.
        LogError: There are several drives, or a record is not readable.
    """
    del descriptor
    file = _input_file(path)
    records = _records(file)
    odometer = records["odom3"]
    ranges = np.concatenate([records[name] for name in _RANGES])
    for name, rows in (("odom3", odometer), ("pseudorange3", ranges)):
        if not len(rows):
            raise LogError(f"{file.name}: no record {name}; it holds no smartLoc drive")
    tables = {
        "imu": pd.DataFrame({"t": odometer[:, 0], "gyro_z": odometer[:, 6]}),
        "odometer": pd.DataFrame({"t": odometer[:, 0], "speed": odometer[:, 1]}),
        "ranges": _ranges(file, ranges),
    }
    files = dict.fromkeys(tables, file.name)
    truth = file.with_name(file.name.removesuffix(INPUT) + TRUTH)
    if file.name.endswith(INPUT) and truth.is_file():
        tables["reference"], files["reference"] = _reference(truth), truth.name
    return Published(
        tables=tables,
        files=files,
        source=f"smartloc: {file.parent}",
        time_scale="seconds from the start of the recording",
        range_corrections=("satellite_clock", "ionosphere", "troposphere"),
    )


def is_smartloc(path: Path) -> bool:
    """Tell whether a file, or a file below a folder, is the input of a smartLoc drive.

    Args:
        path: File or folder.
    """
    files = [path] if path.is_file() else sorted(path.rglob(f"*{INPUT}"))
    return any(file.suffix == ".txt" and _first_word(file) in NUMBERS for file in files)


def _first_word(file: Path) -> str:
    with file.open("rb") as stream:
        return stream.read(64).decode("ascii", errors="replace").split(" ")[0]


def _input_file(path: Path) -> Path:
    if path.is_file():
        return path
    found = sorted(path.rglob(f"*{INPUT}"))
    if not found:
        raise LogNotFoundError(
            f"{path}: no …{INPUT} in or below it, which a smartLoc drive needs; found "
            f"{listing(path)}"
        )
    if len(found) > 1:
        names = ", ".join(str(file.relative_to(path)) for file in found[:4])
        raise LogError(f"{path}: {len(found)} drives below it ({names}); name one of these files")
    return found[0]


def _records(file: Path) -> dict[str, FloatArray]:
    """Return the numbers of the records of each kind, a row per record."""
    rows: dict[str, list[list[float]]] = {name: [] for name in NUMBERS}
    try:
        lines = file.read_text(encoding="ascii").splitlines()
    except UnicodeDecodeError as error:
        raise LogError(f"{file.name}: not readable as text ({error}); fetch it again") from error
    for number, line in enumerate(lines, start=1):
        name, *words = line.split() or [""]
        if name not in NUMBERS:
            continue
        if len(words) != NUMBERS[name]:
            raise LogError(
                f"{file.name}: line {number}: {name} with {len(words)} numbers, expected "
                f"{NUMBERS[name]}; the line is cut short or of another version"
            )
        try:
            rows[name].append([float(word) for word in words])
        except ValueError as error:
            raise LogError(f"{file.name}: line {number}: {name}: {error}") from error
    return {name: np.array(found).reshape(-1, NUMBERS[name]) for name, found in rows.items()}


def _ranges(file: Path, rows: FloatArray) -> pd.DataFrame:
    t, pseudorange, variance, x, y, z, number, system, _, cn0 = rows.T
    negative = variance < 0.0
    if negative.any():
        at = t[int(np.argmax(negative))]
        raise LogError(f"{file.name}: pseudorange3 at {at:g} s has a negative variance")
    pairs = pd.Series(list(zip(system, number, strict=True)), dtype=object)
    names = {pair: _satellite(file, *pair) for pair in pairs.unique()}
    columns = {"pseudorange": pseudorange, "cn0": cn0, "std_range": np.sqrt(variance)}
    columns |= {"sat_x": x, "sat_y": y, "sat_z": z}
    table = pd.DataFrame({"t": t, "satellite": pairs.map(names), **columns})
    # The two records may be mixed; the times of each are in order.
    return table.sort_values("t", kind="stable", ignore_index=True)


def _satellite(file: Path, system: float, number: float) -> str:
    """Return a satellite's RINEX name.

    GLONASS satellites are numbered from 301 by the receiver and from 33, behind those of GPS, by
    RTKLIB; SBAS from 120 and QZSS from 193 as they broadcast.
    """
    letter = SYSTEMS.get(int(system)) if system.is_integer() else None
    if letter is None or not number.is_integer() or number < 1.0:
        known = ", ".join(f"{code} ({name})" for code, name in SYSTEMS.items())
        raise LogError(
            f"{file.name}: pseudorange3 of satellite {number:g} of system {system:g}; known "
            f"systems are {known}"
        )
    plain = int(number)
    if letter == "R":
        plain -= 300 if plain > 300 else 32 if plain > 32 else 0
    elif letter == "S" and plain >= 120:
        plain -= 100
    elif letter == "J" and plain >= 193:
        plain -= 192
    return f"{letter}{plain:02d}"


def _reference(file: Path) -> pd.DataFrame:
    rows = _records(file)["point3"]
    if not len(rows):
        raise LogError(f"{file.name}: no record point3, which ground truth consists of")
    lat, lon, height = frames.geodetic_from_ecef(torch.from_numpy(rows[:, 1:4].copy()))
    columns = {"lat": lat, "lon": lon, "height": height}
    return pd.DataFrame({"t": rows[:, 0], **{name: part.numpy() for name, part in columns.items()}})
