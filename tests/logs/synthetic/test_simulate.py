"""The one call: same seed same bytes, stamps and rates as asked, errors that add up."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.logs.columns import TABLES
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import GRADES, SimulatedDrive, simulate_drive
from navlearn.logs.validate import validate_log


def small(**changes: object) -> SimulatedDrive:
    asked = {"profile": "town", "duration": 90.0, "imu_rate_hz": 50.0, "seed": 3, "standstill": 5.0}
    return simulate_drive(**(asked | changes))  # type: ignore[arg-type]


def as_bytes(log: DriveLog) -> bytes:
    return b"".join(table.to_numpy().tobytes() for table in log.tables().values())


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    return small()


def test_same_seed_gives_identical_bytes(drive: SimulatedDrive) -> None:
    again = small()
    assert as_bytes(again.log) == as_bytes(drive.log)
    assert as_bytes(again.ideal) == as_bytes(drive.ideal)
    assert again.log.metadata == drive.log.metadata
    other = small(seed=4)
    assert as_bytes(other.log) != as_bytes(drive.log)


def test_one_sensor_does_not_change_another(drive: SimulatedDrive) -> None:
    grade = GRADES["mems_m"]
    other = small(grade=replace(grade, gnss=GRADES["low_cost_obd"].gnss), fix_rate_hz=2.0)
    pd.testing.assert_frame_equal(other.log.imu, drive.log.imu, check_exact=True)
    pd.testing.assert_frame_equal(other.log.odometer, drive.log.odometer, check_exact=True)
    assert not other.log.fixes.equals(drive.log.fixes)


def test_tables_pass_the_door_with_known_columns(drive: SimulatedDrive) -> None:
    for log in (drive.log, drive.ideal):
        validate_log(log)
        for name, table in log.tables().items():
            assert set(table) - {"t"} == set(TABLES[name]), name
            assert np.isfinite(table.to_numpy()).all()


def test_rates_and_stamps() -> None:
    drive = small(imu_rate_hz=40.0, odometer_rate_hz=4.0, fix_rate_hz=0.5, reference_rate_hz=2.0)
    assert drive.log.imu["t"].to_numpy() == pytest.approx(np.arange(1, 3601) / 40.0)
    assert drive.log.odometer["t"].to_numpy() == pytest.approx(np.arange(361) / 4.0)
    assert drive.log.fixes["t"].to_numpy() == pytest.approx(np.arange(46) / 0.5)
    assert drive.log.reference is not None
    assert drive.log.reference["t"].to_numpy() == pytest.approx(np.arange(181) / 2.0)
    assert drive.gyro_deterministic_error.shape == (3600,)


def test_imu_samples_are_means_over_the_interval_before() -> None:
    """Ten samples at 100 Hz average to one at 10 Hz."""
    fast, slow = small(imu_rate_hz=100.0), small(imu_rate_hz=10.0)
    for column in ("gyro_z", "accel_x", "accel_y", "accel_z"):
        means = fast.ideal.imu[column].to_numpy().reshape(-1, 10).mean(axis=1)
        np.testing.assert_allclose(slow.ideal.imu[column], means, atol=2e-6)


def test_reading_less_truth_is_deterministic_plus_stochastic(drive: SimulatedDrive) -> None:
    error = drive.log.imu["gyro_z"].to_numpy() - drive.ideal.imu["gyro_z"].to_numpy()
    random = sum(drive.gyro_errors.stochastic.values())
    left = error - drive.gyro_deterministic_error - random
    assert np.abs(left).max() <= 0.5 * math.radians(0.005) * (1.0 + 1e-9)


@pytest.mark.parametrize("grade", [g for g in GRADES if g != "ideal"])
def test_every_grade_has_errors_and_the_ideal_none(grade: str) -> None:
    drive = small(grade=grade, duration=30.0)
    for name, table in drive.ideal.tables().items():
        measured = drive.log.tables()[name]
        assert np.array_equal(table["t"], measured["t"])
        if name != "reference":
            assert not np.allclose(table.to_numpy(), measured.to_numpy(), rtol=0, atol=1e-9)
    perfect = small(grade="ideal", duration=30.0)
    for name in ("imu", "odometer", "fixes"):
        if name == "imu":
            columns = [c for c in perfect.log.imu if c != "temperature"]
            pd.testing.assert_frame_equal(perfect.log.imu[columns], perfect.ideal.imu[columns])
        else:
            pd.testing.assert_frame_equal(perfect.log.tables()[name], perfect.ideal.tables()[name])


def test_latencies_delay_the_stamps() -> None:
    late = replace(
        GRADES["ideal"],
        odometer=replace(GRADES["ideal"].odometer, latency=0.3),
        gnss=replace(GRADES["ideal"].gnss, latency=0.2),
    )
    drive = small(grade=late)
    assert drive.log.metadata.odometer_latency == 0.3
    assert drive.log.metadata.gnss_latency == 0.2
    assert drive.ideal.metadata.gnss_latency == 0.0
    assert drive.log.fixes["t"].iloc[0] == 1.0
    ideal = drive.ideal.odometer
    valid = np.interp(drive.log.odometer["t"] - 0.3, ideal["t"], ideal["speed"])
    assert drive.log.odometer["speed"].to_numpy()[3:] == pytest.approx(valid[3:], abs=1e-9)
    reference = drive.log.reference
    assert reference is not None
    lat = np.interp(drive.log.fixes["t"] - 0.2, reference["t"], reference["lat"])
    assert np.abs(drive.log.fixes["lat"] - lat).max() * 6.4e6 < 0.01


def test_metadata_say_what_it_is(drive: SimulatedDrive) -> None:
    about = drive.log.metadata
    assert about.is_truth
    assert about.name == "town_mems_m_3"
    assert about.interval_means == ("imu",)
    assert about.extra == {"simulated": True, "profile": "town", "grade": "mems_m", "seed": 3}
    assert "0.6 °/√h" in about.sensors["imu"]
    assert small(name="mine", lever_arm=(0.1, 0.2, 0.3)).log.metadata.lever_arm == (0.1, 0.2, 0.3)


def test_the_origin_is_where_the_drive_starts() -> None:
    drive = small(origin=(0.1, 2.0, 500.0), grade="ideal")
    assert drive.log.reference is not None
    assert drive.log.reference[["lat", "lon", "height"]].iloc[0].tolist() == pytest.approx(
        [0.1, 2.0, 500.0]
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": -1}, "seed: found -1"),
        ({"grade": "best"}, "grade: found 'best'"),
        ({"profile": "sea"}, "profile: found 'sea'"),
        ({"imu_rate_hz": 0.0}, "imu_rate_hz: found 0.0"),
        ({"fix_rate_hz": float("nan")}, "fix_rate_hz: found nan"),
        ({"origin": (44.0, -76.0, 0.0)}, "convert degrees"),
        ({"duration": 5.01, "imu_rate_hz": 0.2}, "at least two IMU samples"),
    ],
)
def test_refusals(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        small(**changes)
