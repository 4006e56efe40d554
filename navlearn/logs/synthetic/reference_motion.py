"""A drive's reference as the motion that simulated receivers measure: semi-synthetic data."""

import math
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.columns import REFERENCE
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.interval_means import typical_period
from navlearn.logs.reference import reference_at
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.inverse import Truth
from navlearn.logs.synthetic.motion import Kinematics

ANGLES: Final = ("azimuth", "pitch", "roll")

_LONGEST = 2.5


def required_reference(log: DriveLog, made: str, *, angles: bool) -> pd.DataFrame:
    """Return the reference that something is made from.

    Args:
        log: The drive.
        made: What is made, with its verb, for the message: ``aiding is``.
        angles: Whether its angles are needed, for a lever arm.

    Raises:
        LogError: There is no reference, or a column is missing.
    """
    reference = log.reference if log.reference is not None else pd.DataFrame()
    needed = ("lat", "lon", "v_e", "v_n", *(ANGLES if angles else ()))
    missing = [name for name in needed if name not in reference]
    if missing:
        found = ", ".join(map(str, reference.columns)) or "no reference"
        raise LogError(
            f"{log.metadata.name}: reference: no {', '.join(missing)}, which {made} made from"
            f"{' with a lever arm' if angles else ''} (found: {found}); choose a log whose "
            "reference has them"
        )
    return reference


def reference_stamps(reference: pd.DataFrame, rate_hz: float, latency: float) -> Array:
    """Return uniform stamps whose samples were valid within the reference, s.

    Args:
        reference: The reference.
        rate_hz: Rate of the samples, Hz.
        latency: How late they are stamped, s.
    """
    t = reference["t"].to_numpy(np.float64)
    begin = math.ceil((float(t[0]) + latency) * rate_hz - 1e-9)
    end = math.floor((float(t[-1]) + latency) * rate_hz + 1e-9)
    return np.arange(begin, end + 1) / rate_hz


def place_at(log: DriveLog, t: Array) -> pd.DataFrame:
    """Return the reference at given times with all of its columns, NaN where it is not known.

    Args:
        log: Drive with a reference.
        t: Times, s, shape (N,).
    """
    known = log.tables()["reference"]["t"].to_numpy(np.float64)
    found = reference_at(log, t, max_gap=_LONGEST * typical_period(known))
    lacking = dict.fromkeys((name for name in REFERENCE if name not in found), np.nan)
    return found.assign(**lacking)


def reference_truth(log: DriveLog, t: Array, *, arm: bool) -> Truth:
    """Return the motion of a reference, NaN where it pauses.

    Args:
        log: Drive with a reference; without heights it drives on the ellipsoid.
        t: Times, s, shape (N,).
        arm: Whether the angles and their rates are wanted, for a lever arm; else all kinematics
            are zero.
    """
    place = place_at(log, t)
    columns = {name: place[name].to_numpy(np.float64, copy=True) for name in REFERENCE}
    v_l = np.stack([columns[name] for name in ("v_e", "v_n", "v_u")], axis=-1)
    still = np.zeros(t.size)
    kinematics = Kinematics(*(still for _ in Kinematics._fields))
    if arm:
        step = 0.5 * typical_period(log.tables()["reference"]["t"].to_numpy(np.float64))
        before, after = place_at(log, t - step), place_at(log, t + step)
        turned = {n: _wrapped((after[n] - before[n]).to_numpy(np.float64)) for n in ANGLES}
        kinematics = kinematics._replace(
            **{name: columns[name] for name in ANGLES},
            **{f"{name}_rate": change / (2.0 * step) for name, change in turned.items()},
        )
    return Truth(
        t=t,
        lat=columns["lat"],
        lon=columns["lon"],
        height=columns["height"] if "height" in log.tables()["reference"] else still,
        v_l=v_l,
        kinematics=kinematics,
    )


def _wrapped(angle: Array) -> Array:
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi
