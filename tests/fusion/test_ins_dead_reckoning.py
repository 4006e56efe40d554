"""Where full-IMU dead reckoning starts, and how far it carries, against simulated truth."""

import math

import numpy as np
import pytest
import torch

from navlearn.attitude import matrix_from_quaternion
from navlearn.errors import LogError
from navlearn.frames import enu_between
from navlearn.fusion.ins_dead_reckoning import ins_dead_reckoning_start
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.states import FixTiming, GnssFix, ImuSample


def drive(grade, seed=11):
    log = simulate_drive(profile="town", grade=grade, duration=260.0, seed=seed).log
    return log, imu_timeline(log)


@pytest.fixture(scope="module")
def mems():
    return drive("mems_m")


def before(line, time):
    kept = line.fix_time < time
    return (
        line.samples,
        GnssFix(*(channel[kept] for channel in line.fixes)),
        FixTiming(*(channel[kept] for channel in line.timing)),
    )


def coasted(log, line, start, seconds):
    """Return the horizontal error after some seconds of strapdown alone, m."""
    after = slice(start.sample + 1, start.sample + 1 + round(seconds * 100))
    path = strapdown_over_time(
        start.state,
        ImuSample(*(channel[after] for channel in line.samples)),
        gyro_bias=start.gyro_bias,
        accel_bias=start.accel_bias,
    )
    t = line.t[after].numpy()
    truth = [
        torch.tensor(np.interp(t, log.reference["t"], log.reference[name]))
        for name in ("lat", "lon", "height")
    ]
    east, north, _ = enu_between(*path[:3], *truth)
    return torch.hypot(east, north)


def test_error_free_sensors_need_no_fix_for_a_minute():
    log, line = drive("ideal")
    start = ins_dead_reckoning_start(*before(line, 150.0))
    error = coasted(log, line, start, 60.0)
    # The last fix is the truth; attitude is matched to a few thousandths of a degree.
    assert float(error[0]) < 0.01
    assert float(error[-1]) < 1.0


def test_position_and_velocity_are_the_last_fix(mems):
    _, line = mems
    samples, fixes, timing = before(line, 150.0)
    start = ins_dead_reckoning_start(samples, fixes, timing)
    assert start.sample == int(timing.index[-1])
    assert float(start.state.lat) == pytest.approx(float(fixes.lat[-1]), abs=1e-9)
    assert start.state.v_l.tolist() == pytest.approx(
        [float(fixes.v_e[-1]), float(fixes.v_n[-1]), float(fixes.v_u[-1])]
    )


def test_a_mems_imu_drifts_as_its_attitude_lets_it(mems):
    """1° of tilt is 77 m in 30 s; a matched attitude and standstill's biases do better."""
    log, line = mems
    errors = [
        float(coasted(log, line, ins_dead_reckoning_start(*before(line, t)), 30.0)[-1])
        for t in (120.0, 150.0, 180.0, 210.0)
    ]
    assert np.median(errors) < 40.0


def test_nothing_after_the_last_fix_is_looked_at(mems):
    _, line = mems
    samples, fixes, timing = before(line, 150.0)
    start = ins_dead_reckoning_start(samples, fixes, timing)
    spoilt = [channel.clone() for channel in samples]
    for channel in spoilt[1:]:
        channel[start.sample + 1 :] = 5.0
    again = ins_dead_reckoning_start(ImuSample(*spoilt), fixes, timing)
    for one, other in zip(start.state, again.state, strict=True):
        assert torch.equal(one, other)
    assert torch.equal(start.gyro_bias, again.gyro_bias)


def test_at_a_traffic_light_the_drive_before_tells_azimuth(mems):
    """A window that saw no motion is no use: the next one reaches back to it."""
    log, line = mems
    speed = np.hypot(log.reference["v_e"], log.reference["v_n"]).to_numpy()
    still = log.reference["t"].to_numpy()[speed < 0.01]
    stop = float(still[still > 60.0][-1]) if (still > 60.0).any() else math.nan
    assert stop == stop, "the simulated drive has a stop after its first minute"
    start = ins_dead_reckoning_start(*before(line, stop))
    assert float(start.state.v_l.norm()) < 0.3
    C_lb = matrix_from_quaternion(start.state.q_lb)
    azimuth = float(torch.atan2(C_lb[0, 1], C_lb[1, 1]))
    row = int(np.searchsorted(log.reference["t"], float(line.t[start.sample])))
    error = azimuth - float(log.reference["azimuth"].iloc[row])
    assert abs((error + math.pi) % (2.0 * math.pi) - math.pi) < math.radians(3.0)


def test_a_gap_shortens_the_stretch_but_never_forbids_it(mems):
    _, line = mems
    told = before(line, 150.0)
    whole = ins_dead_reckoning_start(*told)
    for gap, differs in (((13000, 13100), True), ((14800, 14900), False), ((100, 200), False)):
        bridged = torch.zeros(len(line.t), dtype=torch.bool)
        bridged[slice(*gap)] = True
        start = ins_dead_reckoning_start(*told, bridged=bridged)
        assert torch.equal(start.state.q_lb, whole.state.q_lb) != differs, gap


def test_advice_where_nothing_tells_the_attitude(mems):
    _, line = mems
    with pytest.raises(LogError, match=r"no fix before the outage has both position and velocity"):
        ins_dead_reckoning_start(*before(line, 0.0))
    with pytest.raises(LogError, match=r"no stretch of up to 480 s before the last fix"):
        ins_dead_reckoning_start(*before(line, 25.0))
