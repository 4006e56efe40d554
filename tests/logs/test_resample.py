from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from navlearn.errors import ConfigError, LogError
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.resample import ResampleOptions, riss_timeline


def test_a_log_on_the_grid_passes_through(make_log, tables):
    """Interval-mean samples on their own grid are the tensors themselves."""
    t = np.arange(1, 101) / 10.0
    imu = tables["imu"].iloc[1:].assign(t=t)
    log = make_log(imu=imu, metadata=LogMetadata(name="x", interval_means=("imu",)))
    line = riss_timeline(log, rate_hz=10.0)
    assert line.start_time == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(line.t, t, atol=1e-12)
    np.testing.assert_allclose(line.samples.yaw_rate, imu["gyro_z"], atol=1e-13)
    np.testing.assert_allclose(line.samples.f_y, imu["accel_y"], atol=1e-12)
    np.testing.assert_allclose(line.samples.dt, 0.1, atol=1e-12)


@pytest.mark.parametrize("rate_hz", [1.0, 7.3, 10.0, 50.0])
def test_turned_angle_and_distance_do_not_depend_on_the_rate(make_log, tables, rate_hz):
    line = riss_timeline(make_log(), rate_hz=rate_hz)
    end = float(line.t[-1])
    fine = np.linspace(0.0, end, 200001)
    angle = np.interp(fine, tables["imu"]["t"], tables["imu"]["gyro_z"]).mean() * end
    way = np.interp(fine, tables["odometer"]["t"], tables["odometer"]["speed"]).mean() * end
    assert float((line.samples.yaw_rate * line.samples.dt).sum()) == pytest.approx(angle, abs=1e-6)
    assert float((line.samples.speed * line.samples.dt).sum()) == pytest.approx(way, abs=1e-3)


def test_shapes_and_types(make_log):
    line = riss_timeline(make_log(), rate_hz=10.0)
    assert {x.shape for x in line.samples} == {torch.Size([100])}
    assert {x.dtype for x in (*line.samples, *line.fixes, line.t, line.fix_time)} == {torch.float64}
    assert line.timing.index.dtype == torch.int64
    assert not line.samples.pitch.any()
    assert not line.samples.roll.any()


def test_latency_in_the_metadata_is_removed(make_log):
    known = LogMetadata(name="late", gnss_latency=0.2, odometer_latency=0.5)
    line = riss_timeline(make_log(metadata=known), rate_hz=10.0)
    assert float(line.fix_time[0]) == pytest.approx(0.8)
    ended = riss_timeline(make_log(metadata=replace(known, latency_removed=True)), rate_hz=10.0)
    assert float(ended.fix_time[0]) == 0.0
    # The odometer's ramp of 0.1 m/s² comes half a second earlier.
    assert float(line.samples.speed[0] - ended.samples.speed[0]) == pytest.approx(0.05, abs=1e-12)


def test_fixes_change_no_sample_and_no_earlier_fix(make_log, tables):
    line = riss_timeline(make_log(), rate_hz=10.0, dims=3)
    poisoned = tables["fixes"].copy()
    poisoned.loc[6:, ["lon", "height", "v_e", "v_n", "std_e"]] = 0.7
    other = riss_timeline(make_log(fixes=poisoned), rate_hz=10.0, dims=3)
    for mine, theirs in zip(line.samples, other.samples, strict=True):
        assert torch.equal(mine, theirs)
    for mine, theirs in zip(
        (*line.fixes, *line.timing), (*other.fixes, *other.timing), strict=True
    ):
        assert torch.equal(mine[:6], theirs[:6])
    assert not torch.equal(line.fixes.lon[6:], other.fixes.lon[6:])


def test_a_shorter_log_gives_the_same_beginning(make_log):
    log = make_log()
    whole = riss_timeline(log, rate_hz=10.0, dims=3)
    part = riss_timeline(log.between(0.0, 7.0), rate_hz=10.0, dims=3)
    # One odometer sample of look-ahead, one more for standing still.
    for mine, theirs in zip(part.samples, whole.samples, strict=True):
        torch.testing.assert_close(mine[:60], theirs[:60], rtol=0.0, atol=1e-12)


def test_the_last_speed_is_held_to_the_end_of_a_cut_drive(make_log):
    log = make_log().between(0.0, 6.95)
    line = riss_timeline(log, rate_hz=10.0)
    assert float(line.t[-1]) == pytest.approx(6.9)
    assert float(line.samples.speed[-1]) == pytest.approx(9.65)
    short = riss_timeline(log, rate_hz=10.0, options=ResampleOptions(max_odometer_hold=0.0))
    assert float(short.t[-1]) == pytest.approx(6.5)


def test_tilt_of_a_parked_nose_up_car(make_log, tables):
    pitch = 0.05
    imu = tables["imu"].assign(accel_x=0.0, accel_y=9.8062 * np.sin(pitch), gyro_z=0.0)
    odometer = tables["odometer"].assign(speed=0.0)
    line = riss_timeline(make_log(imu=imu, odometer=odometer), rate_hz=10.0, dims=3)
    np.testing.assert_allclose(line.samples.pitch, pitch, atol=1e-4)
    np.testing.assert_allclose(line.samples.roll, 0.0, atol=1e-4)


def test_tilt_needs_accelerometers(make_log, tables):
    log = make_log(imu=tables["imu"][["t", "gyro_z"]])
    assert not riss_timeline(log, rate_hz=10.0).samples.f_y.any()
    with pytest.raises(LogError, match=r"no accel_x and no accel_y.*use dims=2"):
        riss_timeline(log, rate_hz=10.0, dims=3)


def test_a_short_gap_is_bridged_and_a_long_one_named(make_log, tables):
    imu = tables["imu"]
    short = imu[(imu["t"] < 4.0) | (imu["t"] > 4.25)]
    line = riss_timeline(make_log(imu=short), rate_hz=10.0)
    np.testing.assert_allclose(line.samples.yaw_rate[41], 0.02 + 0.001 * np.sin(4.15), atol=1e-4)
    long = imu[(imu["t"] < 4.0) | (imu["t"] > 6.05)]
    message = (
        r"small: imu column gyro_z has no value for 2.20 s after t = 3.90 s, more than the 0.5"
    )
    with pytest.raises(LogError, match=message):
        riss_timeline(make_log(imu=long), rate_hz=10.0)
    riss_timeline(make_log(imu=long), rate_hz=10.0, options=ResampleOptions(max_imu_gap=3.0))


def test_a_long_gap_in_the_odometer(make_log, tables):
    odometer = tables["odometer"]
    gap = odometer[(odometer["t"] < 3.0) | (odometer["t"] > 7.0)]
    with pytest.raises(LogError, match=r"odometer has no sample for 5.00 s after t = 2.50 s"):
        riss_timeline(make_log(odometer=gap), rate_hz=10.0)


def test_missing_values_of_an_accelerometer_are_bridged(make_log, tables):
    accel = tables["imu"]["accel_y"].copy()
    accel[40:43] = np.nan
    line = riss_timeline(make_log(imu=tables["imu"].assign(accel_y=accel)), rate_hz=10.0)
    np.testing.assert_allclose(line.samples.f_y, 0.1 + 0.01 * (line.t - 0.05), atol=1e-12)
    accel[40:60] = np.nan
    with pytest.raises(LogError, match=r"imu column accel_y has no value for 2.10 s"):
        riss_timeline(make_log(imu=tables["imu"].assign(accel_y=accel)), rate_hz=10.0)


def test_streams_on_different_clocks(make_log, tables):
    odometer = tables["odometer"].assign(t=tables["odometer"]["t"] + 1e5)
    with pytest.raises(LogError, match="check that both use the same clock"):
        riss_timeline(make_log(odometer=odometer), rate_hz=10.0)


@pytest.mark.parametrize("wrong", [{"rate_hz": 0.0}, {"rate_hz": np.nan}, {"dims": 4}])
def test_impossible_wishes(make_log, wrong):
    with pytest.raises(ConfigError):
        riss_timeline(make_log(), **{"rate_hz": 10.0, **wrong})


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(0.02, 0.4), min_size=5, max_size=60),
    st.lists(st.floats(0.2, 2.0), min_size=3, max_size=20),
    st.lists(st.floats(0.0, 20.0), min_size=1, max_size=20),
    st.floats(0.7, 40.0),
)
def test_any_log_becomes_a_whole_timeline(imu_steps, odometer_steps, fix_times, rate_hz):
    imu_t, odometer_t = np.cumsum(imu_steps), np.cumsum(odometer_steps)
    fix_t = np.unique(fix_times)
    log = DriveLog(
        imu=pd.DataFrame({"t": imu_t, "gyro_z": np.sin(imu_t)}),
        odometer=pd.DataFrame({"t": odometer_t, "speed": np.abs(np.cos(odometer_t))}),
        fixes=pd.DataFrame({"t": fix_t, "lat": 0.7, "lon": 0.1}),
        reference=None,
        metadata=LogMetadata(name="any"),
    )
    try:
        line = riss_timeline(log, rate_hz=rate_hz)
    except LogError as error:
        refusal = str(error)
        assume("no whole interval" not in refusal)
        pytest.fail(refusal)
    assert all(bool(torch.isfinite(x).all()) for x in (*line.samples, *line.fixes))
    np.testing.assert_allclose(np.diff(line.t), 1.0 / rate_hz, rtol=1e-6)
    index, delay = line.timing
    assert bool((index.diff() >= 0).all())
    assert bool(((index >= 0) & (index < line.t.numel())).all())
    torch.testing.assert_close(line.t[index] - delay, line.fix_time, rtol=0.0, atol=1e-9)
    inner = line.fix_time >= line.t[0]
    assert bool((delay[inner].abs() <= 0.5 / rate_hz + 1e-9).all())
    assert bool((delay <= 1.0 / rate_hz + 1e-9).all())
