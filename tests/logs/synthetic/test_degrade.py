"""Semi-synthetic logs: the stated error and nothing else."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.reading import read_log
from navlearn.logs.synthetic import GRADES, degrade_gyro, simulate_drive
from navlearn.logs.synthetic.inertial_errors import gyro_errors, warming

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("NAVLEARN_DATA") or ROOT / ".." / "shared/data")


@pytest.fixture(scope="module")
def log() -> DriveLog:
    return simulate_drive(
        profile="town", grade="tactical", duration=200.0, seed=1, imu_rate_hz=20.0
    ).log


def test_only_gyro_and_words_change(log: DriveLog) -> None:
    worse = degrade_gyro(log, "mems_l", seed=5)
    for name in ("odometer", "fixes", "reference"):
        pd.testing.assert_frame_equal(worse.tables()[name], log.tables()[name], check_exact=True)
    kept = ["t", "accel_x", "accel_y", "accel_z", "temperature"]
    pd.testing.assert_frame_equal(worse.imu[kept], log.imu[kept], check_exact=True)
    assert (np.abs(worse.imu["gyro_z"] - log.imu["gyro_z"]) > 1e-4).mean() > 0.5
    assert worse.metadata.name == f"{log.metadata.name}_mems_l_5"
    assert "semi-synthetic: gyro error of grade mems_l, seed 5" in worse.metadata.sensors["imu"]
    stated = worse.metadata.extra["semi_synthetic"]
    assert isinstance(stated, dict)
    assert stated["grade"] == "mems_l"


def test_the_stated_coefficients_are_those_added(log: DriveLog) -> None:
    worse = degrade_gyro(log, "mems_x", seed=2)
    error = (worse.imu["gyro_z"] - log.imu["gyro_z"]).to_numpy()
    w = log.imu["gyro_z"].to_numpy()
    regressors = np.stack([np.ones_like(w), w, np.abs(w), w * np.abs(w)], axis=-1)
    found = np.linalg.lstsq(regressors, error, rcond=None)[0]
    stated = worse.metadata.extra["semi_synthetic"]
    assert isinstance(stated, dict)
    assert found[1] == pytest.approx(stated["scale_factor"], abs=3e-3)
    assert found[2] == pytest.approx(stated["even"], abs=3e-3)


def test_same_seed_same_error(log: DriveLog) -> None:
    first, again, other = (degrade_gyro(log, "mems_m", seed=s).imu for s in (1, 1, 2))
    assert first.equals(again)
    assert not first.equals(other)


def test_a_lone_gyro_gets_what_it_can_sense_and_a_temperature() -> None:
    drive = simulate_drive(profile="town", grade="ideal", duration=120.0, imu_rate_hz=10.0)
    bare = drive.ideal.with_tables({"imu": drive.ideal.imu[["t", "gyro_z"]]})
    worse = degrade_gyro(bare, "mems_l", seed=3)
    assert list(worse.imu) == ["t", "gyro_z", "temperature"]
    assert worse.imu["temperature"].iloc[-1] > worse.imu["temperature"].iloc[0]
    rate = np.zeros((len(bare.imu), 3))
    rate[:, 2] = bare.imu["gyro_z"]
    t = bare.imu["t"].to_numpy()
    expected = gyro_errors(
        rate,
        np.zeros_like(rate),
        warming(t - t[0], 15.0, 900.0),
        0.1,
        grade=GRADES["mems_l"].gyro,
        seed=3,
        purpose="degrade_gyro",
    )[2].apply(rate[:, 2])
    np.testing.assert_allclose(worse.imu["gyro_z"], expected, atol=1e-12)


def test_missing_forces_are_zero_and_a_missing_gyro_is_refused(log: DriveLog) -> None:
    holes = log.imu.assign(accel_x=log.imu["accel_x"].where(log.imu["t"] > 10.0))
    assert np.isfinite(degrade_gyro(log.with_tables({"imu": holes})).imu["gyro_z"]).all()
    blind = log.imu.assign(gyro_z=log.imu["gyro_z"].where(log.imu["t"] > 10.0))
    with pytest.raises(LogError, match="gyro_z has values that are not finite"):
        degrade_gyro(log.with_tables({"imu": blind}))


@pytest.mark.skipif(
    not (DATA / "kingston_2008" / "raw").is_dir(), reason="needs ../shared/data/kingston_2008"
)
def test_a_tactical_gyro_of_a_real_drive_becomes_low_cost() -> None:
    real = read_log(ROOT / "datasets" / "kingston_2008.yaml")
    worse = degrade_gyro(real, "mems_l", seed=0)
    error = (worse.imu["gyro_z"] - real.imu["gyro_z"]).to_numpy()
    assert np.isfinite(error).all()
    # Differences of successive errors at rest are white noise of 2.25 °/√h, and rounding.
    still = np.abs(real.imu["gyro_z"].to_numpy()) < 1e-3
    both = still[1:] & still[:-1]
    dt = float(np.median(np.diff(real.imu["t"])))
    white = np.deg2rad(2.25) / 60.0 / np.sqrt(dt)
    assert np.std(np.diff(error)[both]) == pytest.approx(white * np.sqrt(2.0), rel=0.1)
    assert not worse.metadata.is_truth
    assert "semi_synthetic" in worse.metadata.extra
