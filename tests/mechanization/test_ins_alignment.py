"""Alignment of a full IMU: which way is taken, what comes out, what is said where none works."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from navlearn.attitude import matrix_from_angles, matrix_from_quaternion
from navlearn.errors import ConfigError, LogError
from navlearn.logs.imu_timeline import ImuTimelineOptions, imu_timeline
from navlearn.logs.reading import read_log
from navlearn.logs.reference import reference_at
from navlearn.logs.synthetic import simulate_drive, with_aiding_from_reference
from navlearn.mechanization.ins_alignment import (
    InsAlignmentOptions,
    align_ins,
    stated_alignment,
)
from navlearn.states import FixTiming, GnssFix, ImuSample

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("NAVLEARN_DATA") or ROOT / ".." / "shared" / "data")


def attitude_error(log, line, found):
    """Return the attitude error about east, north and up, deg."""
    row = reference_at(log, line.t[found.sample : found.sample + 1]).iloc[0]
    angles = [
        torch.tensor(float(row[name]), dtype=torch.float64) for name in ("azimuth", "pitch", "roll")
    ]
    turn = matrix_from_quaternion(found.state.q_lb) @ matrix_from_angles(*angles).T
    return Rotation.from_matrix(turn.numpy()).as_rotvec(degrees=True)


@pytest.fixture(scope="module")
def parked():
    """A drive that begins with 30 s of standstill."""
    return simulate_drive(profile="town", grade="mems_m", duration=160.0, seed=11)


def test_a_parked_car_is_levelled_and_takes_its_course(parked):
    line = imu_timeline(parked.log)
    found = align_ins(line.samples, line.fixes, line.timing)
    assert found.method == "levelled+course"
    assert float(line.t[found.sample]) < 40.0
    error = np.abs(attitude_error(parked.log, line, found))
    assert (error < 2.5 * np.degrees(found.attitude_sigma.numpy())).all()
    drift = [
        (parked.log.imu[name] - parked.ideal.imu[name]).iloc[:2500].mean()
        for name in ("gyro_x", "gyro_y", "gyro_z")
    ]
    assert np.degrees(np.abs(found.gyro_bias.numpy() - drift)).max() < 0.01
    assert found.state.v_l.norm() > 4.0


def test_error_free_sensors_are_levelled_without_error():
    drive = simulate_drive(profile="hills", grade="ideal", duration=90.0, seed=12)
    line = imu_timeline(drive.log)
    found = align_ins(line.samples, line.fixes, line.timing)
    assert found.method == "levelled+course"
    assert np.abs(attitude_error(drive.log, line, found)).max() < 0.005
    assert float(found.gyro_bias.norm()) < 1e-7
    assert float(found.accel_bias.norm()) < 1e-4


def test_a_start_in_motion_is_matched(parked):
    log = parked.log.between(60.0, 160.0)
    line = imu_timeline(log)
    assert float(line.samples.stationary[:1000].sum()) == 0.0
    found = align_ins(line.samples, line.fixes, line.timing)
    assert found.method == "velocity_matching"
    error = np.abs(attitude_error(log, line, found))
    assert error[:2].max() < 1.5
    assert error[2] < 3.0
    asked = InsAlignmentOptions(method="velocity_matching")
    late = imu_timeline(parked.log)
    other = align_ins(late.samples, late.fixes, late.timing, asked)
    assert other.method == "velocity_matching"


@pytest.mark.parametrize("start", [0.0, 60.0])
def test_nothing_after_its_fix_is_looked_at(parked, start):
    log = parked.log.between(start, 160.0)
    line = imu_timeline(log)
    found = align_ins(line.samples, line.fixes, line.timing)
    spoilt = [channel.clone() for channel in line.samples]
    for channel in spoilt[1:]:
        channel[found.sample + 1 :] = 7.0
    later = line.timing.index > found.sample
    fixes = GnssFix(*(torch.where(later, 9.0, channel) for channel in line.fixes))
    again = align_ins(ImuSample(*spoilt), fixes, line.timing)
    assert again.sample == found.sample
    assert torch.equal(again.state.q_lb, found.state.q_lb)
    assert torch.equal(again.gyro_bias, found.gyro_bias)


def test_no_attitude_is_carried_across_a_gap(parked):
    line = imu_timeline(parked.log)
    bridged = torch.zeros(len(line.t), dtype=torch.bool)
    bridged[3050:3150] = True  # between standstill and the first fast fix
    found = align_ins(line.samples, line.fixes, line.timing, bridged=bridged)
    assert found.method == "velocity_matching"
    assert float(line.t[found.sample]) >= 31.5 + InsAlignmentOptions().least_window - 0.1
    cleared = align_ins(line.samples, line.fixes, line.timing, bridged=torch.zeros_like(bridged))
    assert cleared.method == "levelled+course"


def kept(line, where):
    fixes = GnssFix(*(channel[where] for channel in line.fixes))
    return line.samples, fixes, FixTiming(*(channel[where] for channel in line.timing))


def test_advice_where_nothing_works(parked):
    line = imu_timeline(parked.log)
    standing = line.fix_time < 28.0
    with pytest.raises(LogError, match=r"full-IMU alignment \(auto\): no window .*turns or"):
        align_ins(*kept(line, standing))
    only = InsAlignmentOptions(method="levelled+course")
    with pytest.raises(LogError, match=r"no fix faster than 4 m/s within 60 s after a standstill"):
        align_ins(*kept(line, standing), only)
    samples, fixes, timing = kept(line, line.fix_time > 0.0)
    silent = fixes._replace(has_velocity=0.0 * fixes.has_velocity)
    with pytest.raises(LogError, match=r"none of \d+ fixes has both position and velocity"):
        align_ins(samples, silent, timing)
    with pytest.raises(ConfigError, match=r"InsAlignmentOptions\.method: found 'fast'"):
        InsAlignmentOptions(method="fast")  # type: ignore[arg-type]


def test_a_stated_start_begins_before_the_first_interval(parked):
    line = imu_timeline(parked.log)
    state = align_ins(line.samples, line.fixes, line.timing).state
    stated = stated_alignment(state, tilt=0.01, azimuth=0.02, position=3.0, velocity=0.5)
    assert stated.sample == -1
    assert stated.attitude_sigma.tolist() == [0.01, 0.01, 0.02]
    assert stated.method == "stated"


@pytest.mark.parametrize(("name", "tilt", "azimuth"), [("0027", 0.6, 2.5), ("0033", 0.6, 2.5)])
def test_kitti_drives_start_in_motion(monkeypatch, name, tilt, azimuth):
    if not (DATA / "kitti_oxts").is_dir():
        pytest.skip(f"{DATA / 'kitti_oxts'} is not there; set NAVLEARN_DATA to the real logs")
    monkeypatch.setenv("NAVLEARN_DATA", str(DATA.resolve()))
    read = read_log(ROOT / "datasets" / f"kitti_{name}.yaml")
    log = with_aiding_from_reference(read, odometer=None, seed=11)
    line = imu_timeline(log, options=ImuTimelineOptions(max_imu_gap=2.0))
    found = align_ins(line.samples, line.fixes, line.timing)
    assert found.method == "velocity_matching"
    error = np.abs(attitude_error(log, line, found))
    assert error[:2].max() < tilt
    assert error[2] < azimuth
    assert math.degrees(float(found.attitude_sigma[2])) <= 3.0
