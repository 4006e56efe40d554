"""Faults put into the fixes of any drive, simulated or recorded, and the record of them.

Faults that are known by time and size are what a test of integrity is judged by. Only the fixes
change: sensors, raw ranges and reference stay as they are.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch

from navlearn.errors import LogError
from navlearn.frames import enu_between, shift_geodetic
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.origin import of_drive
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.fault_options import FaultOptions, Freezes, Offset, Ramps
from navlearn.logs.synthetic.fault_schedule import PlannedFault, planned_faults

_PLACE = ("lat", "lon", "height")
_VELOCITY = ("v_e", "v_n")
_DEVIATIONS = ("std_e", "std_n", "std_u")


class FaultyLog(NamedTuple):
    """A log whose fixes have been tampered with, and what was done.

    Attributes:
        log: The log; ``metadata.extra["faults"]`` tells what was asked for and what came of it.
        table: A row per fault: ``fault`` (number from 1), ``kind``, ``first_row`` of the fixes,
            ``t`` (s, of its first fix), ``duration`` (s, to its last), ``fixes``; where the
            position is farthest off ``east``, ``north``, ``up`` (m) and there ``v_east``,
            ``v_north`` (m/s); ``honest``.
        offsets: A row per fix of the log: ``t``, ``fault`` (0 for none), and by how much it was
            moved ``east``, ``north``, ``up`` (m).
    """

    log: DriveLog
    table: pd.DataFrame
    offsets: pd.DataFrame


class _Moved(NamedTuple):
    """By how much the fixes of one fault are off: m, and m/s; shape (n, 3) and (n, 2)."""

    offset: Array
    velocity: Array


def with_faults(log: DriveLog, options: FaultOptions) -> FaultyLog:
    """Return a log with faults in its fixes, and what they are.

    A fix without position keeps having none. A height, velocity or deviation that the log lacks
    stays absent, but for the horizontal deviations of an honest fault.

    Args:
        log: Any log with fixes.
        options: What is to go wrong; without any kind the fixes stay as they are.

    Raises:
        LogError: The log has no fix with a position.
    """
    fixes = log.fixes.reset_index(drop=True).copy()
    rows = np.flatnonzero(fixes[["lat", "lon"]].notna().all(axis=1).to_numpy())
    if rows.size == 0:
        raise LogError(
            f"{log.metadata.name}: no fix has a position, so that none can be wrong; faults need "
            "a log with fixes"
        )
    sound = fixes.loc[rows].reset_index(drop=True)
    offsets = pd.DataFrame({"t": fixes["t"], "fault": 0, "east": 0.0, "north": 0.0, "up": 0.0})
    found = []
    plan = planned_faults(sound["t"].to_numpy(np.float64), options)
    for number, fault in enumerate(plan, start=1):
        part = sound.iloc[fault.first - 1 : fault.last + 1]
        hit = rows[fault.first : fault.last + 1]
        moved = _moved(part, fault)
        if isinstance(fault.options, Freezes):
            _repeat(fixes, hit, part.iloc[0], fault.options)
        else:
            _apply(fixes, hit, moved, fault.options)
        offsets.loc[hit, "fault"] = number
        offsets.loc[hit, ["east", "north", "up"]] = moved.offset
        found.append(_row(number, fault, int(hit[0]), part["t"].to_numpy()[1:], moved))
    stated = {"asked": asdict(options), "injected": found, "fixes": len(fixes)}
    metadata = replace(
        log.metadata,
        name=f"{log.metadata.name}_faults_{options.seed}",
        extra={**log.metadata.extra, **of_drive(log.metadata), "faults": stated},
    )
    faulty = replace(log, fixes=fixes, metadata=metadata)
    return FaultyLog(faulty, pd.DataFrame(found, columns=COLUMNS), offsets)


def injected_faults(log: DriveLog) -> pd.DataFrame | None:
    """Return the faults that were put into a log, with times on its present clock.

    Args:
        log: The log, all its fixes still in it; a latency may have been taken off their times.

    Returns:
        What :class:`FaultyLog` calls its table, or None where nothing was put in.

    Raises:
        LogError: Fixes are missing that it had when the faults were put in.
    """
    stated = log.metadata.extra.get("faults")
    if not isinstance(stated, Mapping):
        return None
    had = int(stated.get("fixes", len(log.fixes)))
    if len(log.fixes) != had:
        raise LogError(
            f"{log.metadata.name}: has {len(log.fixes)} fixes, and had {had} when "
            "faults were put into them, which are counted by row; cut a log first, then put "
            "faults into it"
        )
    table = pd.DataFrame(stated["injected"], columns=COLUMNS)
    return table.assign(t=log.fixes["t"].to_numpy(np.float64)[table["first_row"].to_numpy(int)])


COLUMNS = (
    *(
        "fault",
        "kind",
        "first_row",
        "t",
        "duration",
        "fixes",
        "east",
        "north",
        "up",
        "v_east",
        "v_north",
    ),
    "honest",
)
"""Columns of the table of faults."""


def _moved(part: pd.DataFrame, fault: PlannedFault) -> _Moved:
    """Return by how much fixes are off.

    Args:
        part: The fix before the fault, and those of the fault.
        fault: The fault.
    """
    if isinstance(fault.options, Freezes):
        return _frozen(part, fault.options)
    t = part["t"].to_numpy(np.float64)
    count = t.size - 1
    heading = np.array((np.sin(fault.azimuth), np.cos(fault.azimuth)))
    direction = np.append(heading, fault.up * fault.options.vertical)
    growth = np.ones(count)
    speed = float(fault.options.velocity)
    if isinstance(fault.options, Ramps):
        growth = (t[1:] - t[0]) / (t[-1] - t[0])
        speed *= fault.size / (t[-1] - t[0])
    return _Moved(fault.size * growth[:, None] * direction, np.tile(speed * heading, (count, 1)))


def _frozen(part: pd.DataFrame, options: Freezes) -> _Moved:
    place = _place(part)
    own = [channel[1:] for channel in place]
    before = [channel[:1].expand_as(own[0]) for channel in place]
    velocity = np.zeros((len(part) - 1, 2))
    if options.velocity and all(name in part for name in _VELOCITY):
        read = part[list(_VELOCITY)].to_numpy(np.float64)
        velocity = np.nan_to_num(read[:1] - read[1:])
    return _Moved(torch.stack(enu_between(*before, *own), -1).numpy(), velocity)


def _place(fixes: pd.DataFrame) -> list[torch.Tensor]:
    """Return latitude, longitude and height of fixes; a height that is not known counts as zero."""
    nothing = np.zeros(len(fixes))
    channels = (fixes.get(name, nothing) for name in _PLACE)
    return [torch.tensor(np.nan_to_num(np.asarray(c, dtype=np.float64))) for c in channels]


def _apply(fixes: pd.DataFrame, hit: np.ndarray, moved: _Moved, options: Offset) -> None:
    """Move fixes in place."""
    offset = torch.tensor(np.ascontiguousarray(moved.offset.T))
    places = shift_geodetic(*_place(fixes.loc[hit]), *offset.unbind(0))
    for name, place in zip(_PLACE, places, strict=True):
        if name in fixes:
            known = fixes.loc[hit, name].notna()
            fixes.loc[hit, name] = np.where(known, place.numpy(), np.nan)
    for axis, name in enumerate(_VELOCITY):
        if name in fixes:
            fixes.loc[hit, name] += moved.velocity[:, axis]
    if options.honest:
        _tell(fixes, hit, moved.offset)


def _repeat(fixes: pd.DataFrame, hit: np.ndarray, before: pd.Series, options: Freezes) -> None:
    """Let fixes repeat the one before them, to the last digit, in place."""
    names = (*_PLACE, *((*_VELOCITY, "v_u") if options.velocity else ()))
    for name in names:
        if name in fixes:
            fixes.loc[hit, name] = before[name]


def _tell(fixes: pd.DataFrame, hit: np.ndarray, offset: Array) -> None:
    """Let the stated deviations tell of an offset: its horizontal size in either direction."""
    size = np.hypot(offset[:, 0], offset[:, 1])
    for name, more in zip(_DEVIATIONS, (size, size, np.abs(offset[:, 2])), strict=True):
        if name not in fixes:
            if name == "std_u":
                continue
            fixes[name] = np.nan
        stated = np.nan_to_num(fixes.loc[hit, name].to_numpy(np.float64))
        told = np.hypot(stated, more)
        fixes.loc[hit, name] = np.where(told > 0.0, told, np.nan)


def _row(
    number: int, fault: PlannedFault, first: int, t: Array, moved: _Moved
) -> dict[str, object]:
    worst = int(np.argmax(np.hypot(moved.offset[:, 0], moved.offset[:, 1])))
    # plus zero: no minus before a nought
    off = [float(one) + 0.0 for one in (*moved.offset[worst], *moved.velocity[worst])]
    honest = not isinstance(fault.options, Freezes) and fault.options.honest
    about = (number, fault.kind, first, float(t[0]), float(t[-1] - t[0]), int(t.size))
    return dict(zip(COLUMNS, (*about, *off, honest), strict=True))
