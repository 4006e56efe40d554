"""What is measured equals what was put in."""

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.logs.drive_log import LogMetadata
from navlearn.logs.quality import (
    check_log,
    estimate_calibration,
    gnss_latency,
    gyro_bias_at_rest,
    gyro_bias_from_turns,
    latency_between,
    odometer_latency,
    odometer_scale,
)
from navlearn.logs.quality.delay_fit import fit_delay


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.02])
def test_odometer_scale(drive, scale):
    found = odometer_scale(drive(odometer_scale=scale, odometer_step=1.0 / 3.6))
    assert found.value == pytest.approx(scale, abs=0.002)
    assert 0.0 < found.std < 0.003


@pytest.mark.parametrize("bias_deg_per_h", [-900.0, 30.0, 1300.0])
def test_gyro_bias_without_the_earth(drive, bias_deg_per_h):
    bias = np.radians(bias_deg_per_h / 3600.0)
    log = drive(gyro_bias=bias)
    rest = gyro_bias_at_rest(log)
    assert rest.value == pytest.approx(bias, abs=4.0 * rest.std)
    assert np.degrees(rest.std) * 3600.0 < 5.0
    turns = gyro_bias_from_turns(log)
    assert turns.value == pytest.approx(bias, abs=4.0 * turns.std)
    report = check_log(log)
    earth = report.figures["earth_rate_up_deg_per_h"]
    assert earth == pytest.approx(15.041 * np.sin(np.radians(50.0)), abs=0.01)
    assert report.figures["gyro_bias_at_rest_deg_per_h"] == pytest.approx(
        bias_deg_per_h + earth, abs=20.0
    )


@pytest.mark.parametrize("latency", [-0.35, 0.0, 0.13, 0.9])
def test_gnss_latency_is_positive_where_stamped_late(drive, latency):
    log = drive(gnss_latency=latency)
    found = gnss_latency(log)
    assert found.value == pytest.approx(latency, abs=0.02)
    assert found.value == pytest.approx(latency, abs=4.0 * found.std)
    turns = latency_between(log, "fixes", "imu")
    assert turns.delay == pytest.approx(latency, abs=0.02)
    assert turns.scale == pytest.approx(1.0, abs=0.01)
    assert latency_between(log, "reference", "imu").delay == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("latency", [-0.4, 0.2])
def test_odometer_latency_by_both_ways(drive, latency):
    log = drive(odometer_latency=latency, gnss_latency=0.25, odometer_step=1.0 / 3.6)
    against_fixes = latency_between(log, "odometer", "fixes")
    assert against_fixes.delay == pytest.approx(latency - 0.25, abs=0.03)
    against_imu = latency_between(log, "odometer", "imu")
    assert against_imu.delay == pytest.approx(latency, abs=0.05)
    assert odometer_latency(log).value == pytest.approx(latency, abs=0.04)


def test_swapping_the_streams_turns_the_sign(drive):
    log = drive(odometer_latency=0.3, odometer_scale=0.98)
    there, back = (
        latency_between(log, *pair) for pair in (("odometer", "fixes"), ("fixes", "odometer"))
    )
    assert back.delay == pytest.approx(-there.delay, abs=1e-12)
    assert back.scale == pytest.approx(1.0 / there.scale, abs=1e-12)


def test_a_drifting_clock_is_followed(drive):
    log = drive(odometer_latency=-0.2, odometer_latency_drift=0.55 / 600.0)
    report = check_log(log)
    assert report.figures["odometer_latency_to_gnss_at_start_s"] == pytest.approx(-0.45, abs=0.05)
    assert report.figures["odometer_latency_to_gnss_at_end_s"] == pytest.approx(0.07, abs=0.05)
    assert "clock drift" in {f.topic for f in report.findings if f.severity == "warning"}
    assert odometer_latency(log).value == pytest.approx(0.07, abs=0.06)


def test_a_stated_latency_is_no_news_and_a_removed_one_is_told(drive):
    def check(**about):
        about = LogMetadata(name="made", gnss_latency=0.3, **about)
        return check_log(drive(gnss_latency=0.3, metadata=about))

    def news(report):
        return [f for f in report.findings if f.topic == "latency"]

    assert not news(check())
    (left,) = news(check(latency_removed=True))
    assert left.where == "fixes"
    assert "0.3 s being taken off already" in left.expected
    assert "+0.60 s" in left.remedy
    (unstated,) = news(check_log(drive(gnss_latency=0.3)))
    assert "stamped 0.30" in unstated.found
    assert "late against the IMU" in unstated.found


def test_means_over_intervals_are_taken_as_such(drive):
    about = LogMetadata(name="made", interval_means=("imu",))
    instant, means = drive(duration=400.0), drive(duration=400.0, metadata=about)
    shift = (
        latency_between(means, "reference", "imu").delay
        - latency_between(instant, "reference", "imu").delay
    )
    assert shift == pytest.approx(0.02, abs=1e-3)  # half the IMU's interval of 0.04 s


def test_gyro_scale_is_reported_per_true(drive):
    report = check_log(drive(gyro_scale=1.03))
    assert report.figures["gyro_scale"] == pytest.approx(1.03, abs=0.003)


def test_errors_against_the_reference(healthy):
    figures = check_log(healthy).figures
    east, north = 1.5 * 6390702.0 * np.cos(np.radians(50.0)) / 6372956.0, 1.0
    draw = np.random.default_rng(5).standard_normal((2, 400_000))
    size = np.hypot(east * draw[0], north * draw[1])
    assert figures["fix_error_median_m"] == pytest.approx(np.median(size), rel=0.1)
    assert figures["fix_error_95_m"] == pytest.approx(np.quantile(size, 0.95), rel=0.15)


def test_share_of_standstill(healthy):
    # The car stands for 27 s of every 120 s, less 2 s kept away from motion on either side.
    assert check_log(healthy).figures["stationary_share"] == pytest.approx(23.0 / 120, abs=0.01)


def test_calibration_knows_nothing_of_the_time_after_its_end(drive):
    log = drive(gyro_bias=0.003, odometer_scale=0.98, gnss_latency=0.2)
    poisoned = {}
    for name, table in log.tables().items():
        late = table["t"] >= 400.0
        poisoned[name] = table.assign(**{c: table[c].where(~late, 1e3) for c in table if c != "t"})
    clean = estimate_calibration(log, until=400.0)
    assert estimate_calibration(log.with_tables(poisoned), until=400.0) == clean
    assert clean.odometer_scale.value == pytest.approx(0.98, abs=0.003)
    assert clean.gyro_bias.value == pytest.approx(0.003, abs=1e-4)
    assert clean.gnss_latency.value == pytest.approx(0.2, abs=0.03)
    assert clean.odometer_latency.value == pytest.approx(0.0, abs=0.04)


def test_calibration_does_not_look_at_the_reference(healthy):
    moved = healthy.with_tables({"reference": healthy.reference.assign(lat=0.1, lon=0.1)})
    assert estimate_calibration(moved) == estimate_calibration(healthy)


def test_position_only_fixes_still_tell_latency_and_scale(drive):
    log = drive(position_noise=0.2, gnss_latency=0.3)
    log = log.with_tables({"fixes": log.fixes.drop(columns=["v_e", "v_n", "v_u"])})
    assert latency_between(log, "fixes", "imu").delay == pytest.approx(0.3, abs=0.1)
    assert odometer_scale(log).value == pytest.approx(1.0, abs=0.01)


def test_streams_without_anything_in_common_are_refused(healthy):
    with pytest.raises(ConfigError, match="nothing compares 'imu' with 'imu'"):
        latency_between(healthy, "imu", "imu")


def test_delay_fit_finds_delay_drift_and_coefficients_to_rounding():
    t = np.arange(0.0, 300.0, 0.5)
    delay = 0.31 + 4e-4 * (t - t.mean())

    def signal(x):
        return np.sin(0.3 * x) + 0.5 * np.sin(0.83 * x + 1.0)

    def design(d):
        return np.stack((signal(t - d), np.ones_like(t)), axis=-1)

    found = fit_delay(
        t, 1.7 * signal(t - delay) - 0.2, design, weight=np.ones_like(t), limit=1.0, with_drift=True
    )
    assert found.delay == pytest.approx(0.31, abs=1e-6)
    assert found.drift == pytest.approx(4e-4, rel=1e-4)
    np.testing.assert_allclose(found.coefficients, [1.7, -0.2], atol=1e-6)


def test_delay_fit_shrugs_off_outliers_and_knows_its_spread():
    t = np.arange(0.0, 400.0, 0.5)

    def signal(x):
        return np.sin(0.3 * x) + 0.5 * np.sin(0.83 * x + 1.0)

    def design(d):
        return np.stack((signal(t - d), np.ones_like(t)), axis=-1)

    misses = []
    for seed in range(60):
        draw = np.random.default_rng(seed)
        y = signal(t - 0.2) + 0.1 * draw.standard_normal(len(t))
        y[draw.random(len(t)) < 0.05] += 5.0
        found = fit_delay(t, y, design, weight=np.ones_like(t), limit=1.0)
        misses.append((found.delay - 0.2) / found.delay_std)
    assert 0.7 < np.std(misses) < 1.4
    assert abs(np.mean(misses)) < 0.6


def test_report_survives_a_round_of_pandas_index_changes(healthy):
    shuffled = healthy.with_tables(
        {"imu": healthy.imu.set_index(pd.Index(healthy.imu["t"].to_numpy() + 7))}
    )
    assert check_log(shuffled).figures == check_log(healthy).figures
