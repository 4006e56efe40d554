"""Readers on the published drives, against the same data prepared as CSV by other hands."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.reading import read_log
from navlearn.logs.reference import reference_at, reference_from_fixes
from navlearn.logs.resample import riss_timeline

DATASETS = Path(__file__).resolve().parents[2] / "datasets"


def described(name: str, data_folder) -> DriveLog:
    data_folder(name.removesuffix("_csv"))
    return read_log(DATASETS / f"{name}.yaml")


def differences(log: DriveLog, other: DriveLog) -> dict[tuple[str, str], float]:
    found = {}
    for name, table in other.tables().items():
        for column in table:
            mine, theirs = log.tables()[name][column], table[column]
            if column == "satellite":
                assert (mine == theirs).all()
                continue
            assert (mine.isna() == theirs.isna()).all()
            found[name, column] = float(np.nanmax(np.abs(mine - theirs)))
    return found


def test_kingston_equals_its_csv(data_folder):
    found = differences(
        described("kingston_2008", data_folder), described("kingston_2008_csv", data_folder)
    )
    # Half a unit in the last place that the CSV prints.
    limits = {"t": 1e-9, "speed": 5.1e-6, "azimuth": 1e-8, "pitch": 1e-8, "roll": 1e-8}
    limits |= dict.fromkeys(("lat", "lon"), 1e-12) | dict.fromkeys(("v_e", "v_n", "v_u"), 5.1e-5)
    limits |= dict.fromkeys(("std_e", "std_n", "std_u"), 5.1e-4)
    ranges = ("pseudorange", "range_rate", "ionosphere", "troposphere")
    limits |= dict.fromkeys((*ranges, *(f"sat_{k}{x}" for k in ("", "v") for x in "xyz")), 5.1e-4)
    for (_, column), difference in found.items():
        assert difference <= limits.get(column, 5.1e-5), column


def test_css_equals_its_csv(data_folder):
    pytest.importorskip("asammdf", reason="navlearn[canedge] is not installed")
    log, other = (described(name, data_folder) for name in ("css_obd_164", "css_obd_164_csv"))
    # The CSV keeps three samples that the sensor itself declares invalid.
    kept = np.isin(np.round(other.imu["t"], 6), np.round(log.imu["t"], 6))
    assert (~kept).sum() == 3
    found = differences(log, other.with_tables({"imu": other.imu[kept].reset_index(drop=True)}))
    limits = {"t": 1e-3, "speed": 5.1e-6}
    for (_, column), difference in found.items():
        assert difference <= limits.get(column, 1e-8), column


def test_kingston_without_a_descriptor(data_folder):
    log = read_log(data_folder("kingston_2008"))
    assert {name: len(table) for name, table in log.tables().items()} == {
        "imu": 21180,
        "odometer": 2119,
        "fixes": 2119,
        "reference": 2118,
        "ranges": 13891,
    }
    up = np.median(log.fixes["height"].to_numpy()[1:] - log.reference["height"].to_numpy())
    assert abs(up) < 1.0
    assert not log.metadata.latency_removed


def test_css_without_a_descriptor(data_folder):
    pytest.importorskip("asammdf", reason="navlearn[canedge] is not installed")
    log = read_log(data_folder("css_obd_164"))
    assert log.imu["accel_z"].mean() == pytest.approx(9.7, abs=0.15)
    assert log.metadata.extra["gnss_clock_drift_ppm"] == pytest.approx(81, abs=10)
    # 40.6 km by GNSS; the odometer reads up to 1 km/h low or high.
    line = riss_timeline(log, rate_hz=10.0)
    assert float((line.samples.speed * line.samples.dt).sum()) == pytest.approx(41_200, rel=0.02)


def test_kingston_imu_samples_are_means_of_the_interval_before(data_folder):
    """Turned angle over whole drives of the gyro against the reference: no lag is left."""
    log = read_log(data_folder("kingston_2008"))
    line = riss_timeline(log, rate_hz=10.0)
    azimuth = np.unwrap(reference_at(log, line.t)["azimuth"].dropna().to_numpy())
    turned = -np.cumsum((line.samples.yaw_rate * line.samples.dt).numpy())[: azimuth.size]
    step = 10
    rate = np.diff(azimuth[::step])
    lags = np.arange(-3, 4)
    spread = [np.std(rate[2:-2] - np.diff(np.roll(turned, lag)[::step])[2:-2]) for lag in lags]
    best = np.polyfit(lags[2:5], np.array(spread[2:5]) ** 2, 2)
    assert lags[int(np.argmin(spread))] == 0
    assert abs(-best[1] / (2 * best[0])) * 0.1 < 0.015


def test_odometer_against_the_reference_after_its_latency_is_removed(data_folder):
    log = described("kingston_2008", data_folder)
    log = replace(log, metadata=replace(log.metadata, odometer_latency=-0.3))
    line = riss_timeline(log, rate_hz=10.0)
    truth = reference_at(log, line.t - 0.05)
    speed = np.hypot(truth["v_e"], truth["v_n"]).to_numpy()
    mine = line.samples.speed.numpy()
    kept = np.isfinite(speed)
    scale = float(mine[kept] @ speed[kept] / (speed[kept] @ speed[kept]))
    assert scale == pytest.approx(0.989, abs=0.005)
    assert np.std(mine[kept] - scale * speed[kept]) < 0.25


@pytest.mark.parametrize("name", ["kingston_2008", "css_obd_164"])
def test_timelines_of_real_drives(data_folder, name):
    log = described(name, data_folder)
    line = riss_timeline(log, rate_hz=10.0, dims=3)
    still = line.samples.stationary > 0
    assert bool((line.samples.speed[still] == 0.0).all())
    assert float(line.samples.pitch.abs().median()) < math.radians(3.0)
    assert float(line.samples.roll.abs().median()) < math.radians(3.0)
    assert 0.9 < line.fix_time.numel() / len(log.fixes) <= 1.0


def test_standing_still_agrees_with_the_reference(data_folder):
    log = described("kingston_2008", data_folder)
    line = riss_timeline(log, rate_hz=10.0)
    truth = reference_at(log, line.t)
    speed = np.hypot(truth["v_e"], truth["v_n"]).to_numpy()
    still = line.samples.stationary.numpy() > 0
    # The odometer reads zero at a crawl: once in this drive for five seconds at 0.2 m/s.
    assert np.nanquantile(speed[still], 0.95) < 0.05
    assert np.nanmax(speed[still]) < 0.3
    parked = np.nanmax(np.stack([np.roll(speed, k) for k in range(-30, 31)]), axis=0) < 0.05
    assert still[parked].mean() > 0.9


def test_fixes_stand_in_for_a_missing_reference(data_folder):
    pytest.importorskip("asammdf", reason="navlearn[canedge] is not installed")
    log = described("css_obd_164", data_folder)
    assert log.reference is None
    assert reference_from_fixes(log)["azimuth"].notna().mean() > 0.9
