"""Clocks of RINEX: weeks, time systems, and the clock of the log."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navlearn.errors import LogError
from navlearn.logs.formats.rinex import RinexRanges
from navlearn.logs.formats.rinex_navigation import read_navigation


def test_across_the_change_of_weeks(files: Any, read: Callable[..., RinexRanges]) -> None:
    """Receptions before and after midnight of Saturday, orbits of both weeks, told modulo 1024."""
    midnight = datetime(2023, 7, 2)
    receptions = [
        (midnight + timedelta(seconds=s), {"G07": (21e6, 0.0, 40.0), "C20": (23e6, 0.0, 40.0)})
        for s in (-1, 1, 5000)
    ]
    texts = [
        files.message("G07", midnight - timedelta(seconds=16), 604784.0, m0=0.7),
        files.message("C20", midnight, 0.0, m0=2.0, week=913.0),
    ]
    found = read(receptions, texts).table
    np.testing.assert_array_equal(found["t"], 604800.0 + np.repeat([-1.0, 1.0, 5000.0], 2))
    alike = read(
        receptions, [text.replace(files.number(2268.0), files.number(220.0)) for text in texts]
    ).table
    np.testing.assert_array_equal(found["sat_x"], alike["sat_x"])
    position = found[["sat_x", "sat_y", "sat_z"]].to_numpy()
    velocity = found[["sat_vx", "sat_vy", "sat_vz"]].to_numpy()
    # both fly on through midnight
    np.testing.assert_allclose(position[2:4] - position[:2], 2.0 * velocity[:2], atol=5.0)


def test_beidou_and_glonass_keep_their_own_time(
    files: Any, read: Callable[..., RinexRanges], tmp_path: Path
) -> None:
    read()
    told = read_navigation([tmp_path / "day.nav"], 2268, (files.OF_WEEK, files.OF_WEEK), "GREC")
    orbits = told.orbits.set_index("satellite")
    assert orbits.loc["G07", "toe"] == files.OF_WEEK
    assert orbits.loc["C20", "toe"] == files.OF_WEEK + 14.0
    assert orbits.loc["C20", "toe_of_week"] == files.OF_WEEK
    assert orbits.loc["C20", "toc"] == files.OF_WEEK + 14.0
    assert told.states.iloc[0]["toe"] == files.OF_WEEK - 900.0 + 18.0


@pytest.mark.parametrize(("system", "ahead"), [("GPS", 0), ("GAL", 0), ("BDT", 14), ("GLO", 18)])
def test_time_system_of_the_receiver(
    files: Any, read: Callable[..., RinexRanges], system: str, ahead: float
) -> None:
    found = read(files.observations(files.usual(), system=system)).table
    np.testing.assert_array_equal(found["t"], files.OF_WEEK + ahead + np.repeat([0.0, 1.0], 4))


def test_an_unknown_time_system(files: Any, read: Callable[..., RinexRanges]) -> None:
    with pytest.raises(LogError, match="time system 'XYZ' of the observation file is not known"):
        read(files.observations(files.usual(), system="XYZ"))


def test_the_clock_of_the_log(files: Any, read: Callable[..., RinexRanges]) -> None:
    """Without a start it counts UTC since 1970, as the clocks of other files do."""
    found = read(clock_start=None)
    utc = (files.NOON - timedelta(seconds=18)).replace(tzinfo=UTC).timestamp()
    assert found.table["t"][0] == pytest.approx(utc, abs=1e-6)
    gps = found.table["t"] + found.gps_time_origin
    np.testing.assert_allclose(gps[:4], 2268 * 604800.0 + files.OF_WEEK, atol=1e-6)
