"""What a simulation knows of its gyro: complete, kept beside the log, never inside it."""

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from navlearn.errors import LogError, LogNotFoundError, OutputExistsError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.sensor_truth import SENSOR_TRUTH, load_sensor_truth
from navlearn.logs.synthetic import GRADES, SimulatedDrive, degrade_gyro, simulate_drive
from navlearn.logs.synthetic.degrade import degraded_drive


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    return simulate_drive(
        profile="town", grade="mems_l", duration=200.0, seed=3, imu_rate_hz=20.0, name="known"
    )


def test_what_is_left_is_the_white_noise_of_the_data_sheet(drive: SimulatedDrive) -> None:
    truth = drive.sensor_truth
    read = drive.log.imu["gyro_z"].to_numpy()
    rest = read - truth.yaw_rate - truth.gyro_error - truth.gyro_drift
    grade = GRADES["mems_l"].gyro
    walk = np.radians(grade.angle_random_walk_deg_per_sqrt_h) / 60.0
    step = np.radians(grade.step_deg_per_s)
    assert rest.std() == pytest.approx(np.hypot(walk / np.sqrt(0.05), step / np.sqrt(12)), rel=0.05)
    assert abs(np.corrcoef(rest[1:], rest[:-1])[0, 1]) < 0.05


def test_the_error_is_the_stated_function_of_motion(drive: SimulatedDrive) -> None:
    truth, drawn, ideal = drive.sensor_truth, drive.gyro_errors.coefficients, drive.ideal.imu
    rate, warm = ideal["gyro_z"].to_numpy(), ideal["temperature"].to_numpy() - 21.0
    made = (
        drawn["turn_on_bias"]
        + drawn["scale_factor"] * rate
        + drawn["even"] * np.abs(rate)
        + drawn["odd"] * rate * np.abs(rate)
        + drawn["cross_first"] * ideal["gyro_x"].to_numpy()
        + drawn["cross_second"] * ideal["gyro_y"].to_numpy()
        + drawn["g_sensitivity_x"] * ideal["accel_x"].to_numpy()
        + drawn["g_sensitivity_y"] * ideal["accel_y"].to_numpy()
        + drawn["temperature"] * warm
    )
    np.testing.assert_allclose(truth.gyro_error, made, atol=1e-12)


def test_it_comes_back_to_the_last_bit_and_stays_out_of_the_log(
    drive: SimulatedDrive, tmp_path: Path
) -> None:
    folder = save_log(drive.log, tmp_path / "d", truth=drive.sensor_truth)
    back = load_sensor_truth(folder)
    for name in ("t", "yaw_rate", "gyro_error", "gyro_drift"):
        np.testing.assert_array_equal(getattr(back, name), getattr(drive.sensor_truth, name))
    assert back.fingerprint() == drive.sensor_truth.fingerprint()
    log = load_log(folder)
    assert set(log.imu.columns) == set(drive.log.imu.columns)
    assert set(log.tables()) == {"imu", "odometer", "fixes", "reference"}


def test_another_log_in_the_folder_takes_the_old_truth_away(
    drive: SimulatedDrive, tmp_path: Path
) -> None:
    save_log(drive.log, tmp_path / "d", truth=drive.sensor_truth)
    save_log(drive.ideal, tmp_path / "d", force=True)
    with pytest.raises(LogNotFoundError, match="an oracle needs a simulated drive"):
        load_sensor_truth(tmp_path / "d")
    (tmp_path / "e").mkdir()
    (tmp_path / "e" / SENSOR_TRUTH).write_bytes(b"somebody's")
    with pytest.raises(OutputExistsError, match=SENSOR_TRUTH):
        save_log(drive.log, tmp_path / "e")


def test_it_is_found_by_the_stamps_of_a_cut_log(drive: SimulatedDrive) -> None:
    part = drive.sensor_truth.of(drive.log.between(50.0, 60.0))
    kept = (drive.sensor_truth.t >= 50.0) & (drive.sensor_truth.t < 60.0)
    np.testing.assert_array_equal(part.gyro_error, drive.sensor_truth.gyro_error[kept])
    late = drive.log.with_tables({"imu": drive.log.imu.assign(t=drive.log.imu["t"] + 0.01)})
    with pytest.raises(LogError, match="belongs to another drive"):
        drive.sensor_truth.of(late)
    empty = drive.log.with_tables({"imu": drive.log.imu.iloc[:0]})
    assert drive.sensor_truth.of(empty).t.size == 0


def test_a_degraded_drive_knows_what_was_added(drive: SimulatedDrive) -> None:
    log: DriveLog = replace(drive.ideal)
    worse = degraded_drive(log, "mems_x", seed=4)
    assert worse.log.imu.equals(degrade_gyro(log, "mems_x", seed=4).imu)
    truth = worse.truth
    np.testing.assert_array_equal(truth.yaw_rate, log.imu["gyro_z"].to_numpy())
    rest = worse.log.imu["gyro_z"] - truth.yaw_rate - truth.gyro_error - truth.gyro_drift
    walk = np.radians(GRADES["mems_x"].gyro.angle_random_walk_deg_per_sqrt_h) / 60.0
    assert rest.std() == pytest.approx(walk / np.sqrt(0.05), rel=0.05)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("t,yaw_rate\n0,1\n", "no column gyro_error, gyro_drift"),
        ("t,yaw_rate,gyro_error,gyro_drift\n0,1,x,2\n", "not all numbers"),
        ("t,yaw_rate,gyro_error,gyro_drift\n0,1,,2\n", "not finite"),
    ],
)
def test_a_broken_file_is_refused(content: str, said: str, tmp_path: Path) -> None:
    (tmp_path / SENSOR_TRUTH).write_bytes(gzip.compress(content.encode()))
    with pytest.raises(LogError, match=said):
        load_sensor_truth(tmp_path)
