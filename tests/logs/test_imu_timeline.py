"""A full IMU on its grid, against hand-made means, the simulator's truth and poisoned values."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn.errors import ConfigError, LogError
from navlearn.logs.drive_log import LogMetadata, StatedStart
from navlearn.logs.imu_timeline import ImuTimelineOptions, imu_timeline
from navlearn.logs.resample import riss_timeline
from navlearn.logs.six_axes import ACCELEROMETERS, GYROS
from navlearn.logs.synthetic import simulate_drive

INTERVAL = LogMetadata(name="small", interval_means=("imu",))


@pytest.fixture(scope="module")
def drive():
    return simulate_drive(profile="town", grade="mems_m", duration=90.0, seed=12).log


def axes(log, names):
    return np.stack([log.imu[name].to_numpy() for name in names], axis=-1)


def test_interval_means_at_their_own_rate_stay_what_they_are(drive):
    line = imu_timeline(drive)
    assert line.start_time == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(line.t, drive.imu["t"], atol=1e-9)
    np.testing.assert_allclose(line.samples.omega_ib_b, axes(drive, GYROS), atol=1e-11)
    np.testing.assert_allclose(line.samples.f_b, axes(drive, ACCELEROMETERS), atol=1e-9)
    np.testing.assert_allclose(line.samples.dt, 0.01, atol=1e-12)
    assert not bool(line.bridged.any())


def test_instants_become_means_of_straight_lines(make_log, tables):
    line = imu_timeline(make_log())
    for k, name in enumerate((*GYROS, *ACCELEROMETERS)):
        values = tables["imu"][name].to_numpy()
        means = 0.5 * (values[1:] + values[:-1])
        found = torch.cat((line.samples.omega_ib_b, line.samples.f_b), -1)[:, k]
        np.testing.assert_allclose(found, means, atol=1e-12)


def test_another_rate_keeps_the_angle_and_the_velocity(drive):
    own, slow = imu_timeline(drive), imu_timeline(drive, rate_hz=10.0)
    assert len(slow.t) == len(own.t) // 10
    for fine, coarse in zip(own.samples[1:3], slow.samples[1:3], strict=True):
        np.testing.assert_allclose((coarse * 0.1).sum(0), (fine * 0.01).sum(0), atol=1e-9)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none(drive, rate):
    with pytest.raises(ConfigError, match=r"rate_hz: found .* positive number"):
        imu_timeline(drive, rate_hz=rate)


def test_odometer_speed_is_that_of_the_two_dimensional_timeline(drive):
    full, plain = imu_timeline(drive, rate_hz=10.0), riss_timeline(drive, rate_hz=10.0)
    shared = plain.t.numel()
    first = int(torch.searchsorted(full.t, plain.t[0] - 1e-6))
    assert bool((full.samples.has_speed[first : first + shared] == 1.0).all())
    np.testing.assert_allclose(
        full.samples.speed[first : first + shared], plain.samples.speed, atol=1e-9
    )


def test_where_the_odometer_is_silent_it_tells_nothing(make_log, tables):
    odometer = tables["odometer"]
    gone = odometer[(odometer["t"] < 2.0) | (odometer["t"] > 7.0)]
    cut = gone[gone["t"] < 9.0]
    samples = imu_timeline(make_log(odometer=cut)).samples
    t = imu_timeline(make_log()).t
    inside = ((t > 1.5 + 1e-9) & (t < 7.5 + 1e-9)) | (t > 8.5 + 1e-9)
    assert bool((samples.has_speed[inside] == 0.0).all())
    assert bool((samples.speed[inside] == 0.0).all())
    assert bool((samples.has_speed[~inside] == 1.0).all())


def test_a_car_without_odometer(make_log, tables):
    log = make_log(odometer=tables["odometer"].iloc[:0])
    samples = imu_timeline(log).samples
    assert float(samples.has_speed.sum()) == 0.0
    with pytest.raises(LogError, match=r"odometer has no rows; .*all six axes.*imu_timeline"):
        riss_timeline(log, rate_hz=10.0)


def test_a_log_without_fixes(make_log, tables):
    line = imu_timeline(make_log(fixes=tables["fixes"].iloc[:0]))
    assert line.fix_time.numel() == line.timing.index.numel() == 0


def test_a_gap_is_refused_or_bridged_and_marked(make_log, tables):
    t = tables["imu"]["t"]
    log = make_log(imu=tables["imu"][(t < 4.05) | (t > 5.75)])
    message = r"imu column gyro_x has no value for 1.80 s after t = 4.00 s, .*raise max_imu_gap"
    with pytest.raises(LogError, match=message):
        imu_timeline(log)
    line = imu_timeline(log, options=ImuTimelineOptions(max_imu_gap=2.0))
    inside = (line.t > 4.0 + 1e-6) & (line.t < 5.8 + 1e-6)
    assert torch.equal(line.bridged, inside)
    # Straight lines: 0.1 + 0.01 t in the middle of the gap.
    middle = int(torch.searchsorted(line.t, 4.9))
    assert float(line.samples.f_b[middle, 1]) == pytest.approx(0.1485, abs=1e-9)


def test_a_hole_in_one_axis_is_refused_too(make_log, tables):
    imu = tables["imu"].copy()
    imu.loc[30:40, "accel_z"] = np.nan
    with pytest.raises(LogError, match=r"imu column accel_z has no value for 1.20 s"):
        imu_timeline(make_log(imu=imu))


def test_latencies_are_taken_off_once(make_log):
    known = LogMetadata(name="late", gnss_latency=0.2)
    late, plain = imu_timeline(make_log(metadata=known)), imu_timeline(make_log())
    np.testing.assert_allclose(late.fix_time, plain.fix_time[1:] - 0.2, atol=1e-12)


@pytest.mark.parametrize("rate", [None, 25.0])
def test_no_value_reaches_back(drive, rate):
    """A wild IMU sample, fix or odometer reading changes nothing before it is told."""
    clean = imu_timeline(drive, rate_hz=rate)
    for name, lead in (("imu", 1), ("fixes", 0), ("odometer", 1)):
        table = drive.tables()[name].copy()
        row = 3 * len(table) // 4
        table.iloc[row:, 1:] = 3.0
        # Two samples are needed before the first that may be touched: instants reach one back.
        time = float(table["t"].iloc[row - lead]) - (0.04 if name == "imu" else 0.0)
        spoilt = imu_timeline(drive.with_tables({name: table}), rate_hz=rate)
        before = clean.t < time - 1e-6
        for found, expected in zip(spoilt.samples, clean.samples, strict=True):
            same = found[before] == expected[before]
            assert bool(same.all()), name
        if name == "fixes":
            for found, expected in zip(spoilt.samples, clean.samples, strict=True):
                assert torch.equal(found, expected)


def test_a_stated_start_goes_with_the_beginning_only(make_log):
    state = StatedStart(
        lat=0.7, lon=0.1, height=9.0, v_e=1.0, v_n=2.0, v_u=0.5, azimuth=0.3, pitch=0.1, roll=0.2
    )
    log = make_log(metadata=replace(INTERVAL, start=state))
    assert log.between(0.0, 5.0).metadata.start == state
    assert log.between(3.0, 9.0).metadata.start is None
