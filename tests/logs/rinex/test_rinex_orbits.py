"""Orbits of RINEX: which message counts, and where satellites were when they sent."""

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from navlearn.errors import LogError
from navlearn.gnss.glonass import glonass_state
from navlearn.gnss.kepler import kepler_state
from navlearn.logs.formats.rinex import RinexRanges
from navlearn.logs.formats.rinex_navigation import read_navigation
from navlearn.logs.formats.rinex_orbits import glonass_ephemeris, kepler_ephemeris

LIGHT = 299792458.0


def test_satellites_when_they_sent(
    files: Any, read: Callable[..., RinexRanges], tmp_path: Path
) -> None:
    """The moment of sending by a root finder: by its own clock it is reception less travel."""
    table = read().table
    told = read_navigation([tmp_path / "day.nav"], 2268, (files.OF_WEEK, files.OF_WEEK), "GREC")
    for row in table.itertuples():
        orbit = told.orbits[told.orbits["satellite"] == row.satellite]
        state = told.states[told.states["satellite"] == row.satellite]

        def at(t: float, orbit: Any = orbit, state: Any = state) -> Any:
            time = torch.tensor([t], dtype=torch.float64)
            if len(orbit):
                return kepler_state(kepler_ephemeris(orbit), time)
            return glonass_state(glonass_ephemeris(state), time)

        stamp = row.t - row.pseudorange / LIGHT

        def early(t: float, at: Any = at, stamp: float = stamp) -> float:
            return t + float(at(t).clock) / LIGHT - stamp

        sent = brentq(early, stamp - 0.01, stamp + 0.01, xtol=1e-13)
        expected = at(sent)
        np.testing.assert_allclose(
            [row.sat_x, row.sat_y, row.sat_z], expected.position[0].numpy(), atol=1e-5, rtol=0
        )
        np.testing.assert_allclose(
            [row.sat_vx, row.sat_vy, row.sat_vz], expected.velocity[0].numpy(), atol=1e-8, rtol=0
        )
        assert row.sat_clock == pytest.approx(float(expected.clock[0]), abs=1e-9)
        assert row.sat_clock_rate == pytest.approx(float(expected.clock_rate[0]), abs=1e-12)


def test_qzss_is_read_as_gps(files: Any, read: Callable[..., RinexRanges]) -> None:
    """The same numbers give the same orbit; the last bit of its health is of another signal."""
    types = {"G": "C1C D1C S1C", "J": "C1C D1C S1C"}
    both = [(files.NOON, {name: (36e6, -500.0, 40.0) for name in ("G02", "J02")})]
    texts = [
        files.message(name, files.NOON, files.OF_WEEK, health=h)
        for name, h in (("G02", 0.0), ("J02", 1.0))
    ]
    table = read(files.observations(both, types=types), texts).table
    assert list(table["satellite"]) == ["G02", "J02"]
    for column in table.columns.drop(["t", "satellite"]):
        assert table[column][0] == table[column][1], column


def test_the_group_delay_of_the_code_that_was_measured(
    files: Any, read: Callable[..., RinexRanges]
) -> None:
    plain = read(texts=files.messages(delay=0.0, delay_2=0.0)).table["sat_clock"][:4]
    late = read(texts=files.messages(delay=1e-8, delay_2=3e-8)).table["sat_clock"][:4]
    # T_GD of GPS, none of GLONASS, BGD(E1, E5b) of I/NAV, T_GD1 of BeiDou
    expected = -LIGHT * np.array([1e-8, 0.0, 3e-8, 1e-8])
    np.testing.assert_allclose(late - plain, expected, atol=1e-6)


def test_the_message_of_the_signal_itself_comes_first(
    files: Any, read: Callable[..., RinexRanges]
) -> None:
    by_e5a = files.message(
        "E11", files.NOON - timedelta(minutes=10), files.OF_WEEK - 600.0, source=258.0, bias=2e-4
    )
    both = read(texts=[by_e5a, *files.messages()]).table
    np.testing.assert_allclose(both["sat_clock"], read().table["sat_clock"])
    alone = read(texts=[by_e5a, *(m for m in files.messages() if not m.startswith("E"))]).table
    difference = alone["sat_clock"][2] - both["sat_clock"][2]
    assert difference == pytest.approx(LIGHT * (1e-4 + 1.1e-8 + 3e-9), abs=1e-3)


def test_the_nearest_message_counts(files: Any, read: Callable[..., RinexRanges]) -> None:
    hours = []
    for h in (-2, 0, 2):
        toc = files.NOON + timedelta(hours=h)
        hours.append(files.message("G07", toc, files.OF_WEEK + 3600.0 * h, bias=1e-5 * (h + 3)))
    start = files.NOON + timedelta(minutes=59, seconds=58, microseconds=500000)
    table = read(
        [(start + timedelta(seconds=k), {"G07": (21e6, 0.0, 40.0)}) for k in range(4)], hours
    ).table
    biases = np.round(table["sat_clock"] / LIGHT * 1e5)
    np.testing.assert_array_equal(biases, [3.0, 3.0, 5.0, 5.0])


def test_satellites_without_a_usable_orbit(files: Any, read: Callable[..., RinexRanges]) -> None:
    told = [
        files.message("G07", files.NOON, files.OF_WEEK),
        files.message("E11", files.NOON - timedelta(hours=5), files.OF_WEEK - 5 * 3600.0),
        files.message("C20", files.NOON, files.OF_WEEK, health=1.0),
    ]
    with pytest.warns(
        UserWarning,
        match=r"day\.obs: 6 of 8 ranges are left out .* in day\.nav \(no orbit: R03; orbit too old "
        r"or too new: E11; unhealthy: C20\); a navigation file of the whole day",
    ):
        found = read(texts=told)
    assert set(found.table["satellite"]) == {"G07"}
    assert found.notes["left out"] == {
        "no orbit": {"R03": 2},
        "orbit too old or too new": {"E11": 2},
        "unhealthy": {"C20": 2},
    }


def test_an_unhealthy_satellite_is_no_reason_to_warn(
    files: Any, read: Callable[..., RinexRanges]
) -> None:
    told = [m for m in files.messages() if not m.startswith("R")]
    found = read(texts=[*told, files.state_message("R03", files.NOON, health=1.0)])
    assert found.notes["left out"] == {"unhealthy": {"R03": 2}}
    assert "R03" not in set(found.table["satellite"])


@pytest.mark.parametrize(("bits", "healthy"), [(0.0, True), (1.0, False), (4.0, False), (8, True)])
def test_galileo_is_healthy_where_e1_is(
    files: Any, read: Callable[..., RinexRanges], bits: float, healthy: bool
) -> None:
    told = [m for m in files.messages() if not m.startswith("E")]
    found = read(texts=[*told, files.message("E11", files.NOON, files.OF_WEEK, health=bits)])
    assert ("E11" in set(found.table["satellite"])) == healthy


def test_no_orbit_at_all(files: Any, read: Callable[..., RinexRanges]) -> None:
    with pytest.raises(
        LogError, match=r"day.obs: no satellite has a usable orbit in day.nav \(no orbit: C20, E11"
    ):
        read(texts=[files.message("G09", files.NOON, files.OF_WEEK)])
    with pytest.raises(
        LogError,
        match=r"day.nav: no orbit of C, E, G, R within hours of the receptions, 2023-06-29 12:00 "
        r"to 12:00; name the navigation file of that day",
    ):
        read(texts=[files.message("G07", files.NOON - timedelta(days=1), files.OF_WEEK - 86400.0)])
