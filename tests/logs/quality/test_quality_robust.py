"""Logs that tell little: the report says so instead of failing or inventing figures."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.quality import check_log, estimate_calibration

EMPTY_FIXES = pd.DataFrame({"t": [], "lat": [], "lon": []}, dtype=np.float64)


def test_without_an_accelerometer(without):
    report = check_log(without("imu", "accel_x", "accel_y", "accel_z"))
    assert report.ok
    assert "accel_y_correlation" in report.not_observable
    assert "tilt_deg" in report.not_observable


def test_with_the_yaw_rate_alone(without):
    log = without("imu", "gyro_x", "gyro_y", "accel_x", "accel_y", "accel_z")
    assert check_log(log).figures["gyro_scale"] == pytest.approx(1.0, abs=0.01)


def test_without_velocities_and_reference(without, healthy):
    fixes = healthy.fixes[["t", "lat", "lon"]]
    log = without("reference").with_tables({"fixes": fixes})
    report = check_log(log)
    assert report.ok
    assert "fixes_velocity_scale" in report.not_observable


def test_without_fixes(healthy):
    report = check_log(healthy.with_tables({"fixes": EMPTY_FIXES}))
    assert report.ok
    assert "gnss_latency_s" in report.not_observable
    assert report.figures["odometer_scale"] == pytest.approx(1.0, abs=0.005)


def test_without_odometer(healthy):
    odometer = pd.DataFrame({"t": [], "speed": []}, dtype=np.float64)
    report = check_log(healthy.with_tables({"odometer": odometer}))
    assert report.ok
    assert "odometer_scale" in report.not_observable


@pytest.mark.parametrize("rows", [0, 1, 2, 5, 30])
def test_with_a_handful_of_rows(healthy, rows):
    log = healthy.with_tables({name: table.head(rows) for name, table in healthy.tables().items()})
    report = check_log(log)
    assert report.to_text()
    assert "gnss_latency_s" in report.not_observable
    assert "odometer_scale" in report.not_observable
    assert ("empty table" in {f.topic for f in report.findings}) == (rows == 0)
    assert estimate_calibration(log).gnss_latency is None


def test_parked_throughout(drive):
    log = drive(speed=np.zeros_like, turn=np.zeros_like, gyro_bias=0.002)
    report = check_log(log)
    assert report.ok
    assert {"gnss_latency_s", "odometer_latency_s", "odometer_scale", "gyro_scale"} <= set(
        report.not_observable
    )
    assert estimate_calibration(log).gyro_bias.value == pytest.approx(0.002, abs=2e-5)


def test_straight_on_at_constant_speed(drive):
    log = drive(speed=lambda t: np.full_like(t, 20.0), turn=np.zeros_like)
    report = check_log(log)
    assert report.ok
    assert {"gnss_latency_s", "odometer_latency_s", "gyro_scale"} <= set(report.not_observable)
    assert report.figures["odometer_scale"] == pytest.approx(1.0, abs=0.003)
    assert "gyro_bias_at_rest_deg_per_h" in report.not_observable


@settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.explicit, Phase.generate],
)
@given(data=st.data())
def test_any_finite_or_missing_numbers_are_survived(data):
    def table(names):
        rows = data.draw(st.integers(0, 12))
        number = st.integers(-(10**8), 10**8).map(lambda x: 1e-3 * x)
        value = st.one_of(number, st.just(float("nan")), st.just(0.0))
        return pd.DataFrame(
            {n: data.draw(st.lists(value, min_size=rows, max_size=rows)) for n in names},
            dtype=np.float64,
        )

    log = DriveLog(
        imu=table(["t", "gyro_z", "accel_x", "accel_y", "accel_z"]),
        odometer=table(["t", "speed"]),
        fixes=table(["t", "lat", "lon", "v_e", "v_n", "height"]),
        reference=table(["t", "lat", "lon", "height", "azimuth"]),
        metadata=LogMetadata(name="any"),
    )
    assert check_log(log).to_text()
    assert estimate_calibration(log, until=3.0) is not None
