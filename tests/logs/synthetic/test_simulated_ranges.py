"""Ranges of a simulated drive: geometry, clock and error add up, and a solver gets back the car."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn import frames
from navlearn.errors import ConfigError
from navlearn.logs.columns import RANGES
from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.range_truth import load_range_truth
from navlearn.logs.reference import reference_at
from navlearn.logs.synthetic import PRESETS, SatelliteOptions, SimulatedDrive, simulate_drive
from navlearn.logs.validate import validate_log

LIGHT, EARTH_RATE = 299792458.0, 7.292115e-5
ARM = (0.4, -1.1, 1.5)
BUSY = replace(PRESETS["urban"], systems=("G", "E", "R"), clock_jump=1e-3, clock_rate=2000.0)


def small(satellites: str | SatelliteOptions | None, **changes: object) -> SimulatedDrive:
    asked = {"profile": "town", "duration": 240.0, "imu_rate_hz": 10.0, "seed": 11, "standstill": 5}
    asked["lever_arm"] = ARM
    return simulate_drive(satellites=satellites, **(asked | changes))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def busy() -> SimulatedDrive:
    return small(BUSY)


@pytest.fixture(scope="module")
def plain() -> SimulatedDrive:
    return small(None)


@pytest.fixture(scope="module")
def exact() -> SimulatedDrive:
    return small(replace(PRESETS["ideal"], systems=("G", "E")), grade="ideal")


def ranges_of(drive: SimulatedDrive) -> pd.DataFrame:
    assert drive.log.ranges is not None
    return drive.log.ranges


def truth_of(drive: SimulatedDrive) -> pd.DataFrame:
    assert drive.range_truth is not None
    return drive.range_truth.table


def cartesian(place: pd.DataFrame) -> np.ndarray:
    """Return Earth-fixed positions by the textbook's formula."""
    lat, lon, height = (place[name].to_numpy() for name in ("lat", "lon", "height"))
    a, f = 6378137.0, 1.0 / 298.257223563
    e2 = f * (2.0 - f)
    n = a / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
    level = (n + height) * np.cos(lat)
    return np.stack(
        (level * np.cos(lon), level * np.sin(lon), (n * (1.0 - e2) + height) * np.sin(lat)), -1
    )


def distance(satellite: np.ndarray, antenna: np.ndarray) -> np.ndarray:
    """Return how far signals travelled while the Earth turned."""
    turned = satellite
    for _ in range(5):
        travel = np.linalg.norm(turned - antenna, axis=-1) / LIGHT
        s, c = np.sin(EARTH_RATE * travel), np.cos(EARTH_RATE * travel)
        x, y, z = satellite.T
        turned = np.stack((c * x + s * y, c * y - s * x, z), axis=-1)
    return np.linalg.norm(turned - antenna, axis=-1)


def satellites(table: pd.DataFrame) -> np.ndarray:
    return table[["sat_x", "sat_y", "sat_z"]].to_numpy()


def test_range_minus_distance_minus_clock_is_the_true_error(busy: SimulatedDrive) -> None:
    ranges, truth = ranges_of(busy), truth_of(busy)
    # Fixes of the error-free drive are the antenna itself.
    antenna = cartesian(ranges[["t"]].merge(busy.ideal.fixes, on="t"))
    rest = ranges["pseudorange"] - distance(satellites(ranges), antenna)
    rest -= truth["clock"] + truth["system_offset"] + truth["range_error"]
    assert np.abs(rest).max() < 1e-6
    parts = ["ionosphere", "troposphere", "orbit", "multipath", "reflection", "thermal"]
    np.testing.assert_allclose(truth[[*parts, "systematic"]].sum(axis=1), truth["range_error"])
    assert truth["range_error"].std() > 1.0
    offsets = truth.groupby(truth["satellite"].str[0])["system_offset"]
    assert (offsets.max() == offsets.min()).all()
    assert offsets.first()["G"] == 0.0
    assert (offsets.first()[["E", "R"]] != 0.0).all()
    ideal = busy.ideal.ranges
    assert ideal is not None
    np.testing.assert_allclose(
        ideal["pseudorange"], ranges["pseudorange"] - truth["range_error"], atol=1e-7
    )


def test_table_is_a_checked_one_and_says_what_it_is(busy: SimulatedDrive) -> None:
    ranges, about = ranges_of(busy), busy.log.metadata
    validate_log(busy.log)
    validate_log(busy.ideal)
    told = {"sat_clock", "sat_clock_rate", "ionosphere", "troposphere"}
    assert set(ranges) == ({"t"} | set(RANGES)) - told
    assert about.range_corrections == ("satellite_clock", "ionosphere", "troposphere")
    assert about.klobuchar == ()
    assert about.gps_time_origin is not None
    assert 0.0 <= about.gps_time_origin - 2400 * 604800.0 < 604800.0
    assert "systems G/E/R" in about.sensors["ranges"]
    assert isinstance(about.extra["satellites"], dict)
    assert about.extra["satellites"]["canyon_share"] == 0.5
    assert ranges["cn0"].min() >= BUSY.cn0_threshold
    assert np.degrees(truth_of(busy)["elevation"]).min() >= BUSY.lowest_deg
    scale = 10.0 ** ((45.0 - ranges["cn0"]) / 20.0)
    np.testing.assert_allclose(ranges["std_range"], BUSY.thermal * scale)
    np.testing.assert_allclose(ranges["std_rate"], BUSY.rate_thermal * scale)
    thermal = truth_of(busy)["thermal"] / ranges["std_range"]
    assert thermal.std() == pytest.approx(1.0, rel=0.05)


def test_the_rest_of_the_log_is_drawn_as_without(
    busy: SimulatedDrive, plain: SimulatedDrive
) -> None:
    drawn = small(replace(BUSY, fixes="drawn"))
    assert plain.log.ranges is None
    assert plain.range_truth is None
    for name, table in plain.log.tables().items():
        pd.testing.assert_frame_equal(drawn.log.tables()[name], table)
        if name != "fixes":
            pd.testing.assert_frame_equal(busy.log.tables()[name], table)
        pd.testing.assert_frame_equal(busy.ideal.tables()[name], plain.ideal.tables()[name])
    pd.testing.assert_frame_equal(ranges_of(drawn), ranges_of(busy))


def test_same_seed_same_ranges_and_one_system_does_not_change_another(busy: SimulatedDrive) -> None:
    again = small(BUSY)
    pd.testing.assert_frame_equal(ranges_of(again), ranges_of(busy))
    pd.testing.assert_frame_equal(truth_of(again), truth_of(busy))
    assert again.log.metadata == busy.log.metadata
    alone = ranges_of(small(replace(BUSY, systems=("G",))))
    gps = ranges_of(busy)
    gps = gps[gps["satellite"].str[0] == "G"].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone, gps)
    other = small(BUSY, seed=12)
    assert other.log.metadata.gps_time_origin != busy.log.metadata.gps_time_origin


def solved(group: pd.DataFrame) -> np.ndarray:
    """Return position and clocks by plain least squares from the Earth's centre."""
    second = (group["satellite"].str[0] != "G").to_numpy(dtype=np.float64)
    clocks = np.stack((np.ones(len(group)), second), axis=1)
    state = np.zeros(5)
    for _ in range(15):
        away = satellites(group) - state[:3]
        far = distance(satellites(group), state[:3])
        rows = np.concatenate((-away / np.linalg.norm(away, axis=1)[:, None], clocks), axis=1)
        short = group["pseudorange"].to_numpy() - far - clocks @ state[3:]
        state += np.linalg.lstsq(rows, short, rcond=None)[0]
    return state


def test_without_errors_least_squares_find_the_antenna(exact: SimulatedDrive) -> None:
    ranges, fixes = ranges_of(exact), exact.ideal.fixes.set_index("t")
    truth = truth_of(exact).drop_duplicates("t").set_index("t")
    offset = truth_of(exact)["system_offset"].abs().max()
    for t, group in list(ranges.groupby("t"))[::40]:
        found = solved(group)
        # Rows turned with the Earth differ by 1e-6 from those used: convergence stays exact.
        assert np.linalg.norm(found[:3] - cartesian(fixes.loc[[t]])[0]) < 1e-5
        assert found[3] == pytest.approx(truth.loc[t, "clock"], abs=1e-5)
        assert abs(found[4]) == pytest.approx(offset, abs=1e-5)


def test_fixes_are_solutions_of_the_ranges(exact: SimulatedDrive, busy: SimulatedDrive) -> None:
    np.testing.assert_allclose(cartesian(exact.log.fixes), cartesian(exact.ideal.fixes), atol=1e-3)
    # v_sat − v_ant along the line of sight instead of the exact rate: millimetres per second.
    for name in ("v_e", "v_n", "v_u"):
        np.testing.assert_allclose(exact.log.fixes[name], exact.ideal.fixes[name], atol=0.01)
    fixes = busy.log.fixes
    true = cartesian(fixes[["t"]].merge(busy.ideal.fixes, on="t"))
    error = np.linalg.norm(cartesian(fixes) - true, axis=1)
    assert 0.5 < np.median(error) < 10.0
    assert "single-point" in busy.log.metadata.sensors["fixes"]
    assert {"std_e", "std_n", "std_u", "std_v"} <= set(fixes)


def test_range_rate_is_the_derivative_of_the_pseudorange() -> None:
    quiet = replace(PRESETS["ideal"], clock_white=0.0, clock_walk=0.0, lowest_deg=10.0)
    drive = small(quiet, grade="ideal", fix_rate_hz=10.0, duration=90.0)
    ranges = ranges_of(drive)
    wide = ranges.pivot_table(index="t", columns="satellite", values=["pseudorange", "range_rate"])
    range_, rate = wide["pseudorange"].to_numpy(), wide["range_rate"].to_numpy()
    h = 0.1
    slope = (8.0 * (range_[3:-1] - range_[1:-3]) - (range_[4:] - range_[:-4])) / (12.0 * h)
    assert np.nanmax(np.abs(rate)) > 300.0
    # The car brakes: its jerk limits a difference over 0.4 s.
    assert np.nanmax(np.abs(slope - rate[2:-2])) < 2e-3
    standing = wide.index.to_numpy()[2:-2] < 4.0
    assert np.nanmax(np.abs(slope - rate[2:-2])[standing]) < 2e-6


def test_late_stamps_belong_to_receptions_before_them() -> None:
    drive = small(PRESETS["ideal"], grade="low_cost_obd", lever_arm=(0.0, 0.0, 0.0))
    ranges, truth = ranges_of(drive), truth_of(drive)
    late = drive.log.metadata.gnss_latency
    assert late == 0.2
    at = reference_at(drive.log, ranges["t"].to_numpy() - late)
    rest = ranges["pseudorange"] - distance(satellites(ranges), cartesian(at)) - truth["clock"]
    assert np.abs(rest).max() < 0.01
    moved = cartesian(reference_at(drive.log, ranges["t"].to_numpy())) - cartesian(at)
    assert np.linalg.norm(moved, axis=1).max() > 2.0


def test_presets_differ_as_their_names_say() -> None:
    spread, heard = [], []
    for name in ("open_sky", "suburban", "urban"):
        drive = small(name, duration=900.0, imu_rate_hz=5.0)
        spread.append(float(np.sqrt((truth_of(drive)["range_error"] ** 2).mean())))
        heard.append(len(ranges_of(drive)))
    assert 1.0 < spread[0] < 3.0
    assert spread[0] < spread[1] < spread[2] < 40.0
    assert heard[0] > heard[1] > heard[2]


def test_it_comes_back_from_a_folder(busy: SimulatedDrive, tmp_path: Path) -> None:
    folder = save_log(busy.log, tmp_path / "d", range_truth=busy.range_truth)
    back = load_log(folder)
    assert back.metadata == busy.log.metadata
    assert back.ranges is not None
    pd.testing.assert_frame_equal(back.ranges, ranges_of(busy))
    pd.testing.assert_frame_equal(load_range_truth(folder).table, truth_of(busy))


def test_a_stated_time_counts() -> None:
    drive = small(replace(PRESETS["ideal"], gps_time=1.2e9 + 0.25), duration=20.0)
    assert drive.log.metadata.gps_time_origin == 1.2e9 + 0.25
    ranges = ranges_of(drive)
    place = [torch.tensor(x) for x in drive.ideal.fixes[["lat", "lon", "height"]].iloc[0]]
    up = frames.enu_from_ecef_matrix(place[0], place[1])[2].numpy()
    away = satellites(ranges)[0] - cartesian(drive.ideal.fixes.iloc[:1])[0]
    assert math.asin(away @ up / np.linalg.norm(away)) > math.radians(7.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"systems": ()}, "systems: found"),
        ({"systems": ("G", "G")}, "each once"),
        ({"systems": ("X",)}, "expected some of G, E, R"),
        ({"thermal": -1.0}, "thermal: found -1.0, expected 0 or more"),
        ({"clock": math.nan}, "clock: found nan"),
        ({"canyon_share": 1.5}, "expected 0 to 1"),
        ({"reflection_shortest": 20.0, "reflection_longest": 10.0}, "expected 20 or more"),
        ({"fixes": "some"}, "single_point or drawn"),
        ({"gps_time": -1.0}, "since 6 January"),
        ({"multipath_time": 0.0}, "expected 1 or more"),
    ],
)
def test_options_refuse_what_makes_no_sense(given: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SatelliteOptions(**given)  # type: ignore[arg-type]


def test_an_unknown_sky_names_its_neighbour() -> None:
    with pytest.raises(ConfigError, match="did you mean 'urban'"):
        small("urbn")
