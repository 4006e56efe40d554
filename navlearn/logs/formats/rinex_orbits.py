"""Which broadcast orbit goes with a range, and where the satellite was when it sent."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torch import Tensor

from navlearn.gnss import signals
from navlearn.gnss.ephemeris import (
    BEIDOU_GEOSTATIONARY,
    EARTH_RATE,
    GRAVITATION,
    GlonassEphemeris,
    KeplerEphemeris,
    SatelliteState,
)
from navlearn.gnss.glonass import glonass_state
from navlearn.gnss.kepler import kepler_state
from navlearn.logs.formats.rinex_navigation import Navigation
from navlearn.logs.interval_means import FloatArray

VALID_FOR: Final = {"G": 7200.0, "J": 7200.0, "E": 14400.0, "C": 7200.0, "R": 1800.0}
"""How far from its reference time a broadcast orbit is used, by constellation, s."""

ROWS_AT_ONCE: Final = 200_000
"""Ranges whose satellites are computed in one batch, to bound memory."""

UNHEALTHY: Final = "unhealthy"
"""Reason for which no navigation file can give an orbit."""

NO_ORBIT: Final = "no orbit"
OUTDATED: Final = "orbit too old or too new"

Rows = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Sent:
    """Where satellites were when they sent, a row per range.

    Attributes:
        state: Position and velocity in axes of the moment of sending, clock; zero where unknown.
        known: Whether a healthy orbit was at hand.
        channel: GLONASS frequency channel, 0 for others.
        missing: Satellites without an orbit, those out of its validity, and unhealthy ones, each
            with how many ranges were lost.
    """

    state: SatelliteState
    known: NDArray[np.bool_]
    channel: FloatArray
    missing: dict[str, dict[str, int]]


def satellites_when_sent(navigation: Navigation, satellite: Sequence[str], stamp: Tensor) -> Sent:
    """Return the states of satellites whose signals were received.

    The message nearest in time counts, even where it says that the satellite is unhealthy.

    Args:
        navigation: Broadcast messages.
        satellite: Satellite of each range, N of them.
        stamp: When it was sent by the satellite's own clock: time of reception less pseudorange
            over the speed of light, s on the time scale of ``navigation``, shape (N,).
    """
    names = np.asarray(satellite, dtype=object)
    missing: dict[str, Counter[str]] = {
        reason: Counter() for reason in (NO_ORBIT, OUTDATED, UNHEALTHY)
    }
    row = np.full(names.size, -1, dtype=np.int64)
    for table in (navigation.orbits, navigation.states):
        _match(table, names, stamp.numpy(), row, missing)
    for name in names[row < 0]:
        if not any(name in counts for counts in missing.values()):
            missing[NO_ORBIT][name] = int((names == name).sum())
    known = row >= 0
    state, channel = _states(navigation, names, stamp, row)
    return Sent(
        state=state,
        known=known,
        channel=channel,
        missing={reason: dict(counts) for reason, counts in missing.items() if counts},
    )


def _match(
    table: pd.DataFrame,
    names: NDArray[np.object_],
    stamp: FloatArray,
    row: Rows,
    missing: dict[str, Counter[str]],
) -> None:
    """Write the row of each range's message into ``row``."""
    if table.empty:
        return
    for name, messages in table.groupby("satellite"):
        at = np.flatnonzero(names == name)
        if not at.size:
            continue
        if "preference" in messages:
            messages = messages[messages["preference"] == messages["preference"].max()]
        messages = messages.sort_values("toe", kind="stable")
        toe = messages["toe"].to_numpy(np.float64)
        nearest = np.searchsorted(0.5 * (toe[1:] + toe[:-1]), stamp[at])
        valid = np.abs(stamp[at] - toe[nearest]) <= VALID_FOR[str(name)[0]]
        healthy = messages["healthy"].to_numpy(bool)[nearest]
        if not valid.all():
            missing[OUTDATED][str(name)] = int((~valid).sum())
        if not healthy[valid].all():
            missing[UNHEALTHY][str(name)] = int((valid & ~healthy).sum())
        chosen = messages.index.to_numpy(np.int64)[nearest]
        row[at] = np.where(valid & healthy, chosen, -1)


def _states(
    navigation: Navigation, names: NDArray[np.object_], stamp: Tensor, row: Rows
) -> tuple[SatelliteState, FloatArray]:
    count = names.size
    position = torch.zeros(count, 3, dtype=torch.float64)
    velocity, clock = torch.zeros_like(position), torch.zeros(count, dtype=torch.float64)
    rate, channel = torch.zeros_like(clock), np.zeros(count)
    letter = np.array([name[0] for name in names])
    for of_glonass in (False, True):
        every = np.flatnonzero((row >= 0) & ((letter == "R") == of_glonass))
        for begin in range(0, every.size, ROWS_AT_ONCE):
            at = every[begin : begin + ROWS_AT_ONCE]
            if of_glonass:
                table = navigation.states.iloc[row[at]]
                channel[at] = table["channel"].to_numpy(np.float64)
                found = _glonass(table, stamp[at])
            else:
                found = _kepler(navigation.orbits.iloc[row[at]], stamp[at])
            position[at], velocity[at], clock[at], rate[at] = found
    return SatelliteState(position, velocity, clock, rate), channel


def _kepler(table: pd.DataFrame, stamp: Tensor) -> SatelliteState:
    ephemeris = kepler_ephemeris(table)
    # a satellite's clock is wrong by up to a millisecond, in which it flies for metres
    sent = stamp
    for _ in range(2):
        sent = stamp - kepler_state(ephemeris, sent).clock / signals.SPEED_OF_LIGHT
    return kepler_state(ephemeris, sent)


def _glonass(table: pd.DataFrame, stamp: Tensor) -> SatelliteState:
    ephemeris = glonass_ephemeris(table)
    ahead = ephemeris.clock_bias + ephemeris.clock_drift * (stamp - ephemeris.toe)
    return glonass_state(ephemeris, stamp - ahead)


def kepler_ephemeris(table: pd.DataFrame) -> KeplerEphemeris:
    """Return messages of :class:`Navigation` as tensors.

    Args:
        table: N rows of ``Navigation.orbits``.
    """
    name = table["satellite"]
    letter = name.str[0]
    tilted = (letter == "C") & name.str[1:].astype(int).isin(BEIDOU_GEOSTATIONARY)
    own = {
        "gravitation": letter.map(GRAVITATION),
        "earth_rate": letter.map(EARTH_RATE),
        "tilted": tilted.astype(np.float64),
    }
    return KeplerEphemeris(
        *(_tensor(own[name] if name in own else table[name]) for name in KeplerEphemeris._fields)
    )


def glonass_ephemeris(table: pd.DataFrame) -> GlonassEphemeris:
    """Return messages of GLONASS as tensors.

    Args:
        table: N rows of ``Navigation.states``.
    """

    def triad(prefix: str) -> Tensor:
        return torch.stack([_tensor(table[f"{prefix}_{axis}"]) for axis in "xyz"], dim=-1)

    return GlonassEphemeris(
        toe=_tensor(table["toe"]),
        position=triad("position"),
        velocity=triad("velocity"),
        acceleration=triad("acceleration"),
        clock_bias=_tensor(table["clock_bias"]),
        clock_drift=_tensor(table["clock_drift"]),
    )


def _tensor(column: "pd.Series[float]") -> Tensor:
    return torch.tensor(column.to_numpy(np.float64))
