"""Real drives against what is known of them (the cards that come with the data)."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from navlearn.logs.quality import check_log, estimate_calibration, gyro_bias_at_rest
from navlearn.logs.quality.latency import compare, ordered
from navlearn.logs.reading import read_log

DATA = Path(
    os.environ.get(
        "NAVLEARN_DATA",
        Path(__file__).resolve().parents[3] / ".." / "shared" / "data",
    )
)


def real(name):
    if not (DATA / name).is_dir():
        pytest.skip(f"{name} is not below {DATA}; set NAVLEARN_DATA to the folder of the logs")
    if name == "css_obd_164":
        pytest.importorskip("asammdf", reason="reading MF4 needs the extra navlearn[canedge]")
    return read_log(DATA / name)


@pytest.fixture(scope="module")
def kingston():
    log = real("kingston_2008")
    return log, check_log(log)


@pytest.fixture(scope="module")
def css():
    log = real("css_obd_164")
    start = time.process_time()
    report = check_log(log)
    return log, report, time.process_time() - start


def test_kingston_is_usable_and_measured(kingston):
    _, report = kingston
    figures = report.figures
    assert report.ok
    assert figures["odometer_scale"] == pytest.approx(0.989, abs=0.005)
    assert figures["gyro_bias_deg_per_h"] == pytest.approx(9.4, rel=0.05)
    assert figures["gyro_scale"] == pytest.approx(1.0, abs=0.001)
    assert figures["imu_rate_hz"] == pytest.approx(10.0)
    assert figures["stationary_share"] > 0.25


def test_kingston_fixes_and_their_outliers(kingston):
    _, report = kingston
    assert report.figures["fix_error_median_m"] == pytest.approx(0.99, rel=0.1)
    assert report.figures["fix_error_95_m"] == pytest.approx(6.8, rel=0.1)
    assert 60.0 < report.figures["fix_error_worst_m"] < 85.0
    assert {"outlying fixes", "position jumps", "clock drift", "interpolated fixes"} <= {
        finding.topic for finding in report.findings
    }


def test_kingston_odometer_clock_runs_from_half_a_second_early_towards_zero(kingston):
    # Speed against the reference in windows of 200 s says the same: -0.50 s, then -0.18 s.
    log, report = kingston
    assert report.figures["odometer_latency_to_gnss_at_start_s"] == pytest.approx(-0.5, abs=0.1)
    start, end = (
        compare(ordered(log.between(*span)), "odometer", "reference").delay
        for span in ((600.0, 800.0), (1950.0, 2119.0))
    )
    assert report.figures["odometer_latency_to_gnss_at_start_s"] == pytest.approx(start, abs=0.1)
    assert report.figures["odometer_latency_to_gnss_at_end_s"] == pytest.approx(end, abs=0.1)
    assert end - start > 0.2


def test_css_is_usable_and_measured(css):
    _, report, _ = css
    figures = report.figures
    assert report.ok
    assert figures["gnss_latency_s"] == pytest.approx(0.25, abs=0.1)
    assert figures["odometer_latency_to_gnss_s"] == pytest.approx(-0.35, abs=0.1)
    assert figures["odometer_latency_s"] == pytest.approx(0.25 - 0.35, abs=0.1)
    assert 0.95 * 0.35 < figures["gyro_bias_deg_per_h"] / 3600.0 < 1.05 * 0.39
    assert figures["imu_gyro_z_step"] == pytest.approx(np.radians(0.25), rel=1e-3)
    assert figures["imu_accel_y_step"] == pytest.approx(0.125, rel=1e-3)
    assert figures["odometer_speed_step"] == pytest.approx(1.0 / 3.6, rel=1e-3)
    assert figures["fixes_interruptions"] == pytest.approx(95, abs=6)


def test_css_rest_and_turns_agree_on_the_bias(css):
    log, _, _ = css
    rest = gyro_bias_at_rest(log)
    assert 0.34 < np.degrees(rest.value) < 0.40


def test_css_is_checked_within_five_seconds(css):
    _, _, seconds = css
    assert seconds < 5.0


@pytest.mark.parametrize("name", ["kingston_2008", "css_obd_164"])
def test_calibration_of_the_first_part_foretells_the_whole(name):
    log = real(name)
    early = estimate_calibration(log, until=1200.0)
    whole = estimate_calibration(log)
    assert early.odometer_scale.value == pytest.approx(whole.odometer_scale.value, abs=0.003)
    assert early.gnss_latency.value == pytest.approx(whole.gnss_latency.value, abs=0.1)
