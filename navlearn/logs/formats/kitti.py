"""Drives as KITTI publishes their OXTS part: a text file of 30 numbers per sample.

``oxts/data/0000000000.txt`` and on, and their times in ``oxts/timestamps.txt``; [Geiger2013]
and the ``dataformat.txt`` beside the data. The RT3003's accelerations and rates are the IMU
(x forward, y left, z up), its own solution is the reference: roll positive left side up, pitch
positive front down, yaw anticlockwise from east. There is neither an odometer nor a receiver's
fix: :func:`navlearn.logs.synthetic.semi_real.with_aiding_from_reference` makes them.

``…_extract`` drives are sampled at 100 Hz; ``…_sync`` drives are thinned to the pictures' 10 Hz,
too slow for a full IMU on a rough road.
"""

import re
from datetime import datetime
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.assemble import Published
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.formats.finding import listing
from navlearn.logs.interval_means import FloatArray

VALUES: Final = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *("ax", "ay", "az", "af", "al", "au", "wx", "wy", "wz", "wf", "wl", "wu"),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)
"""Names of the numbers of one sample, in order."""

GAP: Final = 0.5
"""Time between samples that is told as a gap, s."""

_STAMP: Final = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(\.\d{1,9})?")


def read_kitti(folder: Path, descriptor: Descriptor) -> Published:
    """Return IMU and reference of a KITTI drive.

    Args:
        folder: A folder at or above one drive's ``oxts``.
        descriptor: Its ``geoid_height`` is added to the reference's heights.

    Returns:
        IMU in the unit's axes, and the unit's own solution as reference. ``extra`` holds the gaps
        and what accuracy the unit claims.

    Raises:
        LogNotFoundError: No ``oxts`` folder, timestamps or samples.
        LogError: Several drives, a damaged file, or stamps and samples that do not match.
    """
    oxts = _find(folder)
    stamps, start = _stamps(oxts / "timestamps.txt")
    rows, values = _samples(oxts / "data")
    if rows[-1] >= stamps.size:
        raise LogError(
            f"{oxts}: data/{rows[-1]:010d}.txt has no line in timestamps.txt, which has "
            f"{stamps.size} lines; fetch the drive again"
        )
    t = stamps[rows]
    found = dict(zip(VALUES, values.T, strict=True))
    height = found["alt"] + (descriptor.geoid_height or 0.0)
    return Published(
        tables={"imu": _imu(t, found), "reference": _reference(t, found, height)},
        files=dict.fromkeys(("imu", "reference"), "oxts/data"),
        source=f"kitti: {oxts.parent}",
        axes="FLU",
        time_scale=f"recording computer's clock, s after {start}",
        extra={"gaps": gaps(t), "claimed_accuracy": _accuracy(found)},
    )


def oxts_folder(folder: Path) -> Path | None:
    """Return the first ``oxts`` folder at or below a folder, or None.

    Args:
        folder: Folder to look in.
    """
    if folder.name == "oxts" and (folder / "timestamps.txt").is_file():
        return folder
    found = sorted(folder.rglob("oxts/timestamps.txt"))
    return found[0].parent if found else None


def gaps(t: FloatArray) -> list[list[float]]:
    """Return where samples are missing for long.

    Args:
        t: Times, s, shape (N,).

    Returns:
        Time of the last sample before each gap, from the first sample on, and its length, s.
    """
    step = np.diff(t)
    return [
        [round(float(t[i] - t[0]), 2), round(float(step[i]), 2)] for i in np.flatnonzero(step > GAP)
    ]


def _find(folder: Path) -> Path:
    oxts = oxts_folder(folder)
    if oxts is None:
        raise LogNotFoundError(
            f"{folder}: no oxts/timestamps.txt in or below it, which a KITTI drive needs; found "
            f"{listing(folder)}"
        )
    others = [path.parent for path in folder.rglob("oxts/timestamps.txt") if path.parent != oxts]
    if others:
        raise LogError(
            f"{folder}: {len(others) + 1} drives below it ({oxts.parent.name}, "
            f"{others[0].parent.name} …); name the folder of one"
        )
    if not (oxts / "data").is_dir():
        raise LogNotFoundError(
            f"{oxts}: no folder data beside timestamps.txt; found {listing(oxts)}"
        )
    return oxts


def _stamps(path: Path) -> tuple[FloatArray, str]:
    lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    stamps = []
    first: datetime | None = None
    for number, line in enumerate(lines, start=1):
        found = _STAMP.fullmatch(line.strip())
        try:
            second = datetime.fromisoformat(found[1]) if found else None
        except ValueError:
            second = None
        if found is None or second is None:
            raise LogError(
                f"{path.name}: line {number} is {line[:40]!r}, expected a date and time such as "
                "2011-09-30 12:02:25.967451362; fetch the file again"
            )
        first = first or second
        # Whole seconds and their fraction apart: together they exceed what float64 tells.
        stamps.append((second - first).total_seconds() + float(found[2] or 0.0))
    if not stamps:
        raise LogError(f"{path.name}: the file is empty; fetch it again")
    return np.array(stamps), str(first)


def _samples(folder: Path) -> tuple[np.ndarray, FloatArray]:
    files = sorted(path for path in folder.glob("*.txt") if path.stem.isdigit())
    if not files:
        raise LogNotFoundError(
            f"{folder}: no samples such as 0000000000.txt; found {listing(folder)}"
        )
    values = np.stack([_numbers(path) for path in files])
    return np.array([int(path.stem) for path in files]), values


def _numbers(path: Path) -> FloatArray:
    words = path.read_bytes().split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise LogError(f"oxts/data/{path.name}: not numbers ({error}); fetch it again") from error
    if values.size != len(VALUES):
        raise LogError(
            f"oxts/data/{path.name}: found {values.size} numbers, expected {len(VALUES)}; it is "
            "cut short or of another make"
        )
    return values


def _imu(t: FloatArray, found: dict[str, FloatArray]) -> pd.DataFrame:
    gyros = {f"gyro_{axis}": found[f"w{axis}"] for axis in "xyz"}
    return pd.DataFrame({"t": t, **gyros, **{f"accel_{axis}": found[f"a{axis}"] for axis in "xyz"}})


def _reference(t: FloatArray, found: dict[str, FloatArray], height: FloatArray) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "t": t,
            "lat": np.radians(found["lat"]),
            "lon": np.radians(found["lon"]),
            "height": height,
            "v_e": found["ve"],
            "v_n": found["vn"],
            "v_u": found["vu"],
            "azimuth": np.mod(0.5 * np.pi - found["yaw"], 2.0 * np.pi),
            "pitch": -found["pitch"],
            "roll": found["roll"],
        }
    )


def _accuracy(found: dict[str, FloatArray]) -> dict[str, float]:
    return {
        f"{what}_{name}": round(float(reduce(found[f"{what[:3]}_accuracy"])), 3)
        for what in ("position", "velocity")
        for name, reduce in (("median", np.median), ("worst", np.max))
    }
