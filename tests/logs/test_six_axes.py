"""Each slip of a full IMU's axes and units is named, with what to do."""

import math

import numpy as np
import pytest

from navlearn.errors import LogError
from navlearn.logs.six_axes import check_six_axes


def refused(make_log, imu, match):
    with pytest.raises(LogError, match=match):
        check_six_axes(make_log(imu=imu))


def test_a_sound_imu_passes(make_log):
    check_six_axes(make_log())


def test_missing_and_empty_axes(make_log, tables):
    imu = tables["imu"].drop(columns="gyro_x").assign(accel_z=np.nan)
    message = (
        r"a full IMU needs gyro_x, .*accel_z; found gyro_y, gyro_z, accel_x, accel_y, no values in "
        r"gyro_x, accel_z; .*riss_timeline"
    )
    refused(make_log, imu, message)


def test_degrees_per_second(make_log, tables):
    imu = tables["imu"].assign(gyro_y=tables["imu"]["gyro_z"] * 180.0 / math.pi * 10.0)
    refused(make_log, imu, r"gyro_y exceeds .* rad/s .*gyro_y_deg_per_s or give unit: deg/s")


def test_gravity_taken_off(make_log, tables):
    imu = tables["imu"].assign(accel_z=0.02)
    refused(make_log, imu, r"gravity is missing.*linear acceleration")


def test_units_of_g(make_log, tables):
    imu = tables["imu"].assign(accel_x=0.0, accel_y=0.01, accel_z=1.0)
    refused(make_log, imu, r"units of g.*give unit: g")


def test_another_unit(make_log, tables):
    imu = tables["imu"].assign(accel_x=0.0, accel_y=0.01, accel_z=32.2)
    refused(make_log, imu, r"expected a norm of 9.8; check the unit")


@pytest.mark.parametrize(
    ("axis", "sign", "up"),
    [("accel_x", 1.0, "x"), ("accel_z", -1.0, "-z"), ("accel_y", -1.0, "-y")],
)
def test_another_axis_points_up(make_log, tables, axis, sign, up):
    level = dict.fromkeys(("accel_x", "accel_y", "accel_z"), 0.05)
    imu = tables["imu"].assign(**{**level, axis: sign * 9.8})
    refused(make_log, imu, rf"gravity is felt along {up}; .*up: {up}\}}")
