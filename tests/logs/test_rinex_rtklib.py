"""Satellites of a real navigation file against RTKLIB, which reads and propagates by itself."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from navlearn.gnss import pz90
from navlearn.gnss.ephemeris import SatelliteState
from navlearn.gnss.glonass import glonass_state
from navlearn.gnss.kepler import kepler_state
from navlearn.logs.formats.rinex_navigation import Navigation, read_navigation
from navlearn.logs.formats.rinex_orbits import glonass_ephemeris, kepler_ephemeris

DATA = Path(
    os.environ.get("NAVLEARN_DATA")
    or Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
)
FILE = DATA / "rinex_static" / "raw" / "reach-m2-01_raw_202306291111.nav"
WEEK = 2268
LIGHT = 299792458.0
LETTERS = {1: "G", 4: "R", 8: "E", 16: "J", 32: "C"}

rtklib = pytest.importorskip("pyrtklib")
pytest.importorskip("georinex")
pytestmark = pytest.mark.skipif(not FILE.is_file(), reason="rinex_static is not there")

Array = NDArray[np.float64]


class Peer(NamedTuple):
    """Messages as RTKLIB read them: by satellite, seconds of week and source."""

    kepler: dict[tuple[str, float, bool], Any]
    glonass: dict[tuple[str, float], Any]
    keep_alive: Any


def seconds(time: Any) -> float:
    return float(time.time - 315964800 - WEEK * 604800 + time.sec)


def named(number: int) -> str:
    own = rtklib.Arr1Dint(1)
    letter = LETTERS[rtklib.satsys(number, own)]
    return f"{letter}{own[0]:02d}"


@pytest.fixture(scope="module")
def peer() -> Peer:
    found = rtklib.nav_t()
    rtklib.readrnx(str(FILE), 1, "", rtklib.obs_t(), found, rtklib.sta_t())
    kepler = {}
    for k in range(found.n):
        message = found.eph[k]
        name = named(message.sat)
        by_e5a = name[0] == "E" and bool(message.code & 0b10)
        kepler[name, round(seconds(message.toe), 3), by_e5a] = message
    states = {}
    for k in range(found.ng):
        message = found.geph[k]
        states[named(message.sat), round(seconds(message.toe), 3)] = message
    return Peer(kepler, states, found)


@pytest.fixture(scope="module")
def ours() -> Navigation:
    return read_navigation([FILE], WEEK, (385962.0, 386023.0), "GREC")


def moved(message: Any, after: float, propagate: Any) -> tuple[Array, float]:
    """Return RTKLIB's position (m) and clock (s), so many seconds after its reference time."""
    position, clock = rtklib.Arr1Ddouble(6), rtklib.Arr1Ddouble(2)
    propagate(rtklib.timeadd(message.toe, after), message, position, clock, rtklib.Arr1Ddouble(1))
    return np.array([position[0], position[1], position[2]]), float(clock[0])


def compared(
    state: SatelliteState, message: Any, times: Array, propagate: Any, delay: float
) -> tuple[float, float, float, float]:
    """Return the largest differences: m, m/s, ns and the clock rate's in ns/s."""
    worst = np.zeros(4)
    for k, after in enumerate(times):
        position, clock = moved(message, float(after), propagate)
        before, clock_before = moved(message, float(after) - 1.0, propagate)
        later, clock_later = moved(message, float(after) + 1.0, propagate)
        differences = (
            np.linalg.norm(state.position[k].numpy() - position),
            np.linalg.norm(state.velocity[k].numpy() - 0.5 * (later - before)),
            1e9 * abs(float(state.clock[k]) / LIGHT + delay - clock),
            1e9 * abs(float(state.clock_rate[k]) / LIGHT - 0.5 * (clock_later - clock_before)),
        )
        worst = np.maximum(worst, differences)
    return tuple(worst)


def test_every_message_is_read(ours: Navigation, peer: Peer) -> None:
    found = {
        (row.satellite, round(row.toe, 3), row.satellite[0] == "E" and row.preference == 0.0)
        for row in ours.orbits.itertuples()
    }
    assert found == set(peer.kepler)
    states = {(row.satellite, round(row.toe, 3)) for row in ours.states.itertuples()}
    assert states == set(peer.glonass)
    assert len(found) > 20
    assert len(states) == 10
    ionosphere = [peer.keep_alive.ion_gps[k] for k in range(8)]
    assert list(ours.klobuchar) == ionosphere


@pytest.mark.parametrize("letter", ["G", "E", "C"])
def test_keplerian_satellites(letter: str, ours: Navigation, peer: Peer) -> None:
    times = np.linspace(-7200.0, 7200.0, 9)
    rows = ours.orbits[ours.orbits["satellite"].str[0] == letter]
    assert len(rows) > 6
    for k in range(len(rows)):
        row = rows.iloc[k]
        by_e5a = letter == "E" and row["preference"] == 0.0
        message = peer.kepler[row["satellite"], round(row["toe"], 3), by_e5a]
        told = kepler_ephemeris(rows.iloc[[k]])
        state = kepler_state(told, row["toe"] + torch.tensor(times))
        metres, rate, nanoseconds, drift = compared(
            state, message, times, rtklib.eph2pos, row["group_delay"]
        )
        assert metres < 1e-5, row["satellite"]
        assert rate < 1e-3, row["satellite"]
        assert nanoseconds < 1e-6, row["satellite"]
        assert drift < 1e-6, row["satellite"]
        delay = message.tgd[0] if not (letter == "E" and not by_e5a) else message.tgd[1]
        assert row["group_delay"] == delay
        assert row["healthy"] == (message.svh == 0)


def test_glonass_satellites(ours: Navigation, peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    # RTKLIB takes constants of fewer digits, 4.5 mm after half an hour, and steps of a minute
    monkeypatch.setattr(pz90, "GRAVITATIONAL_CONSTANT", 3.9860044e14)
    monkeypatch.setattr(pz90, "OBLATENESS", 1.0826257e-3)
    times = np.linspace(-1800.0, 1800.0, 13)
    for k in range(len(ours.states)):
        row = ours.states.iloc[k]
        message = peer.glonass[row["satellite"], round(row["toe"], 3)]
        told = glonass_ephemeris(ours.states.iloc[[k]])
        for after in times:
            at = torch.tensor([row["toe"] + after])
            state = glonass_state(told, at, longest_step=60.0)
            metres, rate, nanoseconds, _ = compared(
                state, message, np.array([after]), rtklib.geph2pos, 0.0
            )
            assert metres < 1e-6, row["satellite"]
            assert rate < 1e-4, row["satellite"]
            assert nanoseconds < 1e-6, row["satellite"]
        assert row["channel"] == message.frq
        assert row["healthy"] == (message.svh == 0)


def test_glonass_with_the_constants_of_its_document(ours: Navigation, peer: Peer) -> None:
    times = np.linspace(-1800.0, 1800.0, 5)
    for k in range(len(ours.states)):
        row = ours.states.iloc[k]
        state = glonass_state(
            glonass_ephemeris(ours.states.iloc[[k]]), row["toe"] + torch.tensor(times)
        )
        message = peer.glonass[row["satellite"], round(row["toe"], 3)]
        metres, _, _, _ = compared(state, message, times, rtklib.geph2pos, 0.0)
        assert 1e-3 < metres < 1e-2


def test_a_geostationary_satellite(ours: Navigation, peer: Peer) -> None:
    """None is in the file: one of its messages, said to be of C01, in both programs."""
    rows = ours.orbits[ours.orbits["satellite"] == "C30"]
    message = peer.kepler["C30", round(rows.iloc[0]["toe"], 3), False]
    number = message.sat
    times = np.linspace(-3600.0, 3600.0, 7)
    try:
        message.sat = rtklib.satno(32, 1)
        told = kepler_ephemeris(rows.assign(satellite="C01"))
        assert float(told.tilted) == 1.0
        state = kepler_state(told, rows.iloc[0]["toe"] + torch.tensor(times))
        metres, rate, _, _ = compared(
            state, message, times, rtklib.eph2pos, rows.iloc[0]["group_delay"]
        )
    finally:
        message.sat = number
    assert metres < 1e-5
    assert rate < 1e-3
