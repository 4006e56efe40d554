"""Options of a filter from a standstill of known noise."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import FitError, LogError
from navlearn.learning.allan_start import allan_values, tuned_by_allan
from navlearn.logs.allan.standstill_noise import standstill_noise
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe.filter_options import ekf_options, ins_ekf_options

RATE = 10.0


def parked(seconds: float, walk: float = 0.0) -> DriveLog:
    """Return a parked car: gyros 1e-4, 2e-4, 3e-4 rad/√s, accelerometers 1e-3 m/s/√s."""
    rng = np.random.default_rng(8)
    t = np.arange(int(seconds * RATE)) / RATE
    imu = pd.DataFrame({"t": t})
    for k, axis in enumerate("xyz", start=1):
        drift = walk / math.sqrt(RATE) * np.cumsum(rng.normal(size=t.size))
        imu[f"gyro_{axis}"] = k * 1e-4 * math.sqrt(RATE) * rng.normal(size=t.size) + drift
        imu[f"accel_{axis}"] = 1e-3 * math.sqrt(RATE) * rng.normal(size=t.size)
    return DriveLog(
        imu=imu,
        odometer=pd.DataFrame({"t": t[::10], "speed": 0.0}),
        fixes=pd.DataFrame({"t": [], "lat": [], "lon": []}),
        reference=None,
        metadata=LogMetadata(name="parked"),
    )


def test_the_yaw_gyro_tells_the_riss_filter() -> None:
    values = tuned_by_allan(parked(3600.0, walk=2e-5))
    noise = ekf_options(values.filter).noise
    assert noise.gyro_random_walk == pytest.approx(3e-4, rel=0.05)
    assert noise.gyro_bias_walk == pytest.approx(2e-5, rel=0.5)
    curve_floor = math.sqrt(2.0 * 3e-4 * 2e-5 / math.sqrt(3.0))  # where both lines cross
    assert noise.zero_yaw_rate == pytest.approx(curve_floor, rel=0.3)
    gyro = values.figures["gyro_z"]
    assert isinstance(gyro, dict)
    assert gyro["white_low"] < 3e-4 < gyro["white_high"]


def test_six_axes_tell_the_full_filter_their_root_mean_squares() -> None:
    values = tuned_by_allan(parked(1200.0), sensors="imu")
    noise = ins_ekf_options(values.filter).noise
    assert noise.gyro_random_walk == pytest.approx(1e-4 * math.sqrt(14.0 / 3.0), rel=0.05)
    assert noise.accel_random_walk == pytest.approx(1e-3, rel=0.05)


def test_what_a_short_standstill_does_not_show_is_left_and_said() -> None:
    values = tuned_by_allan(parked(60.0))
    assert "gyro_bias_walk" not in values.filter["noise"]
    assert any("gyro_bias_walk: the standstill is too short" in note for note in values.notes)


def test_a_missing_axis_is_named() -> None:
    log = parked(120.0)
    alone = replace(log, imu=log.imu[["t", "gyro_z"]])
    with pytest.raises(LogError, match="gyro_x has 0 values"):
        tuned_by_allan(alone, sensors="imu")
    with pytest.raises(FitError, match="gyro_x, gyro_y, accel_x"):
        allan_values(standstill_noise(alone), sensors="imu")


def test_no_white_noise_is_replaced_by_what_a_second_shows() -> None:
    log = parked(300.0)
    walk = np.cumsum(np.random.default_rng(9).normal(size=len(log.imu))) * 1e-3 / math.sqrt(RATE)
    values = tuned_by_allan(replace(log, imu=log.imu.assign(gyro_z=walk)))
    found = values.filter["noise"]["gyro_random_walk"]
    assert found == pytest.approx(1e-3 * math.sqrt(1.0 / 3.0), rel=0.2)  # K √(τ / 3) at 1 s
    assert any("no white noise is shown" in note for note in values.notes)


def test_a_simulated_grade_is_found_again() -> None:
    log = simulate_drive(
        profile="town", grade="mems_l", duration=900.0, seed=11, imu_rate_hz=50.0
    ).log
    values = tuned_by_allan(log)
    true = math.radians(2.25) / 60.0
    assert values.filter["noise"]["gyro_random_walk"] == pytest.approx(true, rel=0.2)
