"""A real minute of RINEX: against RTKLIB from file to satellite, and against where it was taken."""

import gzip
import io
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn import frames
from navlearn.gnss.single_point import single_point
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.rinex_observations import read_observations
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.reading import read_log

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("NAVLEARN_DATA") or ROOT / ".." / "shared" / "data")
RAW = DATA / "rinex_static" / "raw"
OBSERVATIONS = RAW / "reach-m2-01_raw_202306291111.23O.gz"
HEADER = torch.tensor([4157198.3767, 671195.0626, 4774772.0490], dtype=torch.float64)
LETTERS = {1: "G", 4: "R", 8: "E", 16: "J", 32: "C"}
WEEK = 2268
LIGHT = 299792458.0

georinex = pytest.importorskip("georinex")
pytestmark = pytest.mark.skipif(not OBSERVATIONS.is_file(), reason="rinex_static is not there")


@pytest.fixture(scope="module")
def log() -> DriveLog:
    with pytest.warns(UserWarning, match=r"no orbit: E31; unhealthy: E14, G22"):
        return read_log(ROOT / "datasets" / "rinex_static.yaml")


@pytest.fixture(scope="module")
def ranges(log: DriveLog) -> pd.DataFrame:
    """Ranges by whole milliseconds of the week and satellite."""
    assert log.ranges is not None
    assert log.metadata.gps_time_origin is not None
    of_week = log.ranges["t"] + (log.metadata.gps_time_origin - WEEK * 604800.0)
    stamp = (of_week * 1e3).round().astype(np.int64)
    return log.ranges.assign(ms=stamp).set_index(["ms", "satellite"])


def rtklibs(folder: Path) -> Iterator[tuple[int, str, Any, Any, Any]]:
    """Yield stamp, satellite, observation, RTKLIB and its navigation, from its own reading."""
    library = pytest.importorskip("pyrtklib")
    plain = folder / "day.23O"
    plain.write_bytes(gzip.decompress(OBSERVATIONS.read_bytes()))
    observed, told, station = library.obs_t(), library.nav_t(), library.sta_t()
    library.readrnx(str(plain), 1, "", observed, told, station)
    navigation = OBSERVATIONS.name.replace(".23O.gz", ".nav")
    library.readrnx(str(RAW / navigation), 1, "", observed, told, station)
    number = library.Arr1Dint(1)
    for k in range(0, observed.n, 37):
        found = observed.data[k]
        letter = LETTERS[library.satsys(found.sat, number)]
        of_week = found.time.time - 315964800 - WEEK * 604800 + found.time.sec
        yield round(1e3 * of_week), f"{letter}{number[0]:02d}", found, library, told


def group_delays(number: int, satellite: str, told: Any) -> set[float]:
    """Return what RTKLIB read as delay of L1 C/A, of E1 by E1 and E5b, of B1I."""
    if satellite[0] == "R":
        return {0.0}
    messages = [told.eph[k] for k in range(told.n)]
    second = satellite[0] == "E"
    return {float(m.tgd[int(second)]) for m in messages if m.sat == number}


def test_ranges_and_satellites_as_rtklib_reads_and_computes_them(
    ranges: pd.DataFrame, tmp_path: Path
) -> None:
    compared = 0
    worst: dict[str, float] = {}
    for stamp, satellite, found, library, told in rtklibs(tmp_path):
        if (stamp, satellite) not in ranges.index:
            # what the reader left out: no orbit, not healthy, no code on the first frequency
            assert satellite in ("E14", "E31", "G22") or found.P[0] == 0.0
            continue
        row = ranges.loc[(stamp, satellite)]
        assert row["pseudorange"] == found.P[0]
        assert row["cn0"] == pytest.approx(1e-3 * found.SNR[0])
        carrier = -found.D[0] * LIGHT / row["range_rate"]
        step = (carrier - 1602e6) / 0.5625e6
        if satellite[0] == "R":
            assert step == pytest.approx(round(step), abs=0.02)
        else:
            known = 1561.098e6 if satellite[0] == "C" else 1575.42e6
            assert carrier == pytest.approx(known, rel=1e-6)
        state, clock = library.Arr1Ddouble(6), library.Arr1Ddouble(2)
        library.satposs(
            found.time, found, 1, told, 0, state, clock, library.Arr1Ddouble(1), library.Arr1Dint(1)
        )
        place = row[["sat_x", "sat_y", "sat_z"]].to_numpy(np.float64)
        speed = row[["sat_vx", "sat_vy", "sat_vz"]].to_numpy(np.float64)
        distance = np.linalg.norm(place - [state[0], state[1], state[2]])
        worst[satellite[0]] = max(worst.get(satellite[0], 0.0), float(distance))
        assert np.linalg.norm(speed - [state[3], state[4], state[5]]) < 2e-3
        # RTKLIB takes the group delay off later
        clocks = [LIGHT * (clock[0] - delay) for delay in group_delays(found.sat, satellite, told)]
        assert min(abs(row["sat_clock"] - expected) for expected in clocks) < 1e-5
        assert row["sat_clock_rate"] == pytest.approx(LIGHT * clock[1], abs=1e-4)
        compared += 1
    assert compared > 400
    assert set(worst) == set("GREC")
    # 4 km/s for the group delay that RTKLIB leaves in the time of sending, too: some 10 ns
    assert max(worst.values()) < 2e-4


def test_observations_as_the_library_reads_them(tmp_path: Path) -> None:
    """georinex's own reader of records, on the first receptions: it takes long for all."""
    text = gzip.decompress(OBSERVATIONS.read_bytes()).decode()
    parts = text.split("\n>")
    few = "\n>".join(parts[:7]) + "\n"
    (tmp_path / "few.obs").write_text(few)
    ours = read_observations(tmp_path / "few.obs").table.set_index(["t", "satellite"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = georinex.rinexobs3(io.StringIO(few))
    begin = np.datetime64("2023-06-25T00:00:00")
    count = 0
    for time in theirs.time.to_numpy():
        t = round(float((time - begin) / np.timedelta64(1, "us")) * 1e-6, 4)
        for satellite in theirs.sv.to_numpy():
            code = {"E": "1X", "C": "2I"}.get(satellite[0], "1C")
            found = theirs.sel(time=time, sv=satellite)
            if np.isnan(found[f"C{code}"]):
                continue
            row = ours.loc[(t, satellite)]
            assert row["pseudorange"] == float(found[f"C{code}"])
            assert row["doppler"] == float(found[f"D{code}"])
            assert row["cn0"] == float(found[f"S{code}"])
            count += 1
    assert count == len(ours)
    assert count > 190


def test_a_whole_drive_log(log: DriveLog) -> None:
    assert log.ranges is not None
    assert set(log.ranges["satellite"].str[0]) == set("GREC")
    assert log.ranges["satellite"].nunique() == 32
    assert log.ranges["t"].nunique() == 610
    # parked and level but for some degrees
    assert log.imu["accel_z"].mean() == pytest.approx(9.78, abs=0.02)
    assert abs(log.imu["gyro_z"].mean()) < 1e-3
    assert np.rad2deg(log.fixes["lat"].mean()) == pytest.approx(48.78066, abs=1e-4)
    assert np.rad2deg(log.fixes["lon"].mean()) == pytest.approx(9.1715, abs=1e-4)
    assert len(log.metadata.klobuchar) == 8


@pytest.mark.parametrize("systems", [None, "G", "R", "E", "C"])
def test_it_was_taken_where_the_header_says(log: DriveLog, systems: str | None) -> None:
    edges = np.arange(-0.1, 61.0, 0.1)
    options = RangeOptions(systems=systems, least_elevation=np.deg2rad(10.0))
    series = ranges_of(log, edges, options)
    assert series.corrections == {
        "satellite_clock": "column",
        "ionosphere": "klobuchar",
        "troposphere": "saastamoinen",
        "earth_rotation": "rotated",
    }
    solved = single_point(series.ranges)
    ok = solved.ok.bool()
    assert ok.double().mean() > 0.9
    place = frames.geodetic_from_ecef(HEADER)
    mean = [part[ok].mean() for part in (solved.lat, solved.lon, solved.height)]
    east, north, up = frames.enu_between(*mean, *place)
    assert torch.hypot(east, north) < 5.0
    assert abs(float(up)) < 15.0


def test_range_rates_are_those_of_a_receiver_at_rest(log: DriveLog) -> None:
    series = ranges_of(log, np.arange(-0.1, 61.0, 0.1))
    away = series.ranges.satellite - HEADER
    unit = away / torch.linalg.vector_norm(away, dim=-1, keepdim=True)
    rate = series.ranges.range_rate - (unit * series.ranges.satellite_velocity).sum(-1)
    rate = torch.where(series.ranges.has_rate > 0.0, rate, torch.nan)
    left = rate - rate.nanmedian(dim=1, keepdim=True)[0]
    assert left.nanmean(dim=0).abs().max() < 0.01
    assert left.abs().nanmedian() < 0.05
