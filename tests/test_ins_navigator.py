"""The full-IMU navigator on simulated drives."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn.errors import LogError
from navlearn.filters.ins_belief import map_ins_belief
from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between
from navlearn.fusion.ins.layout import moved_belief
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.unscented.ins import InsUkf
from navlearn.ins_navigator import (
    InsNavigator,
    InsNavigatorOptions,
    ins_belief_at,
)
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.ins_alignment import stated_alignment
from navlearn.states import FixTiming, GnssFix, ImuSample


@pytest.fixture(scope="module")
def log():
    return simulate_drive(
        profile="town", grade="mems_m", duration=160.0, seed=11, imu_rate_hz=20.0
    ).log


@pytest.fixture(scope="module")
def line(log):
    return imu_timeline(log)


@pytest.fixture(scope="module")
def run(line):
    return InsNavigator().run(line.samples, line.fixes, line.timing)


def horizontal_error(log, line, first, state):
    t = line.t[first : first + state.lat.shape[-1]].numpy()
    truth = [
        torch.tensor(np.interp(t, log.reference["t"], log.reference[name]))
        for name in ("lat", "lon", "height")
    ]
    east, north, _ = enu_between(*state[:3], *truth)
    return torch.hypot(east, north)


def before(line, time):
    kept = line.fix_time < time
    return (
        GnssFix(*(channel[kept] for channel in line.fixes)),
        FixTiming(*(channel[kept] for channel in line.timing)),
    )


def part(samples, begin, end):
    return ImuSample(*(channel[begin:end] for channel in samples))


def test_it_starts_itself_and_follows_the_car(log, line, run):
    assert run.first == run.alignment.sample + 1
    assert run.alignment.method == "levelled+course"
    assert run.samples.dt.shape[-1] == len(line.t) - run.first
    assert torch.equal(run.samples.f_b, line.samples.f_b[run.first :])
    assert float(horizontal_error(log, line, run.first, run.history.trajectory).max()) < 6.0


@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_every_form_of_the_filter_serves(line, run, method):
    short = part(line.samples, 0, 60 * 20)
    fixes, timing = before(line, 60.5)
    found = InsNavigator(InsNavigatorOptions(method=method)).run(short, fixes, timing)
    count = found.samples.dt.shape[-1]
    assert torch.allclose(
        found.history.trajectory.v_l, run.history.trajectory.v_l[:count], rtol=0.0, atol=1e-2
    )


def test_the_belief_at_the_start_is_what_alignment_found(run):
    belief = InsNavigator().start(run.alignment)
    sigma = belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    found = run.alignment
    for span, expected in (
        (slice(3, 6), found.velocity_sigma),
        (slice(6, 9), found.attitude_sigma),
        (slice(9, 12), found.gyro_bias_sigma),
        (slice(12, 15), found.accel_bias_sigma),
    ):
        assert torch.allclose(sigma[span], expected)
    assert sigma[:3].tolist() == pytest.approx(
        [found.position_sigma, found.position_sigma, found.height_sigma]
    )
    assert torch.equal(belief.sensor[:3], found.gyro_bias)
    assert torch.equal(belief.sensor[3:6], found.accel_bias)


@pytest.mark.parametrize("states", [9, 15, 21])
def test_coasting_is_the_prediction_of_the_filter(line, states):
    """Through an outage without odometer, axle and standstill both are the same strapdown."""
    options = InsEkfOptions(
        states=states,
        odometer=False,
        nonholonomic=False,
        zero_velocity=False,
        zero_angular_rate=False,
        correlation_time=500.0,
    )
    navigator = InsNavigator(InsNavigatorOptions(filter=options))
    fixes, timing = before(line, 100.0)
    run = navigator.run(part(line.samples, 0, 110 * 20), fixes, timing)
    block = int(torch.nonzero(run.history.fix >= 0)[-1])
    gone = int(run.history.end[block]) + 1
    belief, rest = ins_belief_at(run.history, block), part(run.samples, gone, None)
    coasted = navigator.coast(belief, rest)
    filtered = navigator.filter_on(belief, rest).trajectory
    assert rest.dt.shape[-1] > 180
    for name, scale in (("lat", 6.4e6), ("lon", 4.6e6), ("height", 1.0), ("v_l", 1.0)):
        expected = getattr(run.history.trajectory, name)[gone:]
        for found in (coasted, filtered):
            difference = (getattr(found, name) - expected).abs().max() * scale
            assert float(difference) < 2e-3, name


def test_a_batch_of_beliefs_coasts_side_by_side(run):
    navigator = InsNavigator()
    blocks = torch.tensor([40, 60])
    samples = [
        part(run.samples, int(run.history.end[b]) + 1, int(run.history.end[b]) + 101)
        for b in blocks
    ]
    together = ImuSample(*(torch.stack(pair) for pair in zip(*samples, strict=True)))
    found = navigator.coast(ins_belief_at(run.history, blocks), together)
    for k, block in enumerate(blocks.tolist()):
        alone = navigator.coast(ins_belief_at(run.history, block), samples[k])
        assert torch.allclose(found.v_l[k], alone.v_l, rtol=0.0, atol=1e-10)


def test_sensor_errors_of_the_belief_are_removed(run):
    """A belief that knows a bias coasts through spoilt samples as if they were clean."""
    navigator = InsNavigator()
    belief, rest = ins_belief_at(run.history, 50), part(run.samples, 1000, 1200)
    bias = torch.tensor([1e-3, -2e-3, 3e-3, 0.1, -0.05, 0.2], dtype=torch.float64)
    spoilt = rest._replace(omega_ib_b=rest.omega_ib_b + bias[:3], f_b=rest.f_b + bias[3:])
    known = belief._replace(
        sensor=belief.sensor + torch.nn.functional.pad(bias, (0, belief.sensor.shape[-1] - 6))
    )
    clean, mended = navigator.coast(belief, rest), navigator.coast(known, spoilt)
    assert torch.allclose(clean.v_l, mended.v_l, rtol=0.0, atol=1e-10)
    assert not torch.allclose(clean.v_l, navigator.coast(belief, spoilt).v_l, atol=0.1)


def test_a_filter_without_bias_states_gets_calibrated_samples(line):
    navigator = InsNavigator(InsNavigatorOptions(filter=InsEkfOptions(states=9)))
    run = navigator.run(line.samples, line.fixes, line.timing)
    expected = line.samples.omega_ib_b[run.first :] - run.alignment.gyro_bias
    assert torch.allclose(run.samples.omega_ib_b, expected, rtol=0.0, atol=1e-15)


def test_a_smoothed_run_is_better(log, line, run):
    smoothed = InsNavigator().smooth(run, line.fixes, line.timing)
    filtered = horizontal_error(log, line, run.first, run.history.trajectory)
    better = horizontal_error(log, line, run.first, smoothed.trajectory)
    assert float(better.square().mean()) < float(filtered.square().mean())


def test_a_stated_start_replaces_alignment(log, line, run):
    row = log.reference.iloc[0]
    moved = map_ins_belief(ins_belief_at(run.history, 0), lambda x: x)
    state = moved_belief(moved, torch.zeros_like(moved.covariance[..., 0])).state._replace(
        lat=torch.tensor(float(row["lat"]), dtype=torch.float64),
        lon=torch.tensor(float(row["lon"]), dtype=torch.float64),
        v_l=torch.zeros(3, dtype=torch.float64),
    )
    stated = stated_alignment(state, tilt=0.02, azimuth=0.5, position=3.0, velocity=0.1)
    navigator = InsNavigator()
    found = navigator.run(line.samples, line.fixes, line.timing, alignment=stated)
    assert found.first == 0
    assert found.samples.dt.shape[-1] == len(line.t)
    assert float(horizontal_error(log, line, 0, found.history.trajectory)[-400:].max()) < 6.0


def test_it_says_when_the_car_never_moved(line):
    fixes, timing = before(line, 25.0)
    with pytest.raises(LogError, match="full-IMU alignment"):
        InsNavigator().run(line.samples, fixes, timing)


def test_alignment_does_not_reach_across_a_bridged_gap(line, run):
    """A gap between standstill and first fast fix leaves velocity matching, after the gap."""
    gap = run.alignment.sample - 5
    bridged = torch.zeros(len(line.t), dtype=torch.bool)
    bridged[gap] = True
    found = InsNavigator().run(line.samples, line.fixes, line.timing, bridged=bridged)
    assert found.alignment.method == "velocity_matching"
    assert found.alignment.sample > gap
    later = bridged.roll(len(line.t) // 2)  # none of alignment's business
    assert InsNavigator().align(*line_of(line), bridged=later).sample == run.alignment.sample


def line_of(line):
    return line.samples, line.fixes, line.timing


def test_false_standstill_on_a_road_of_glass_is_given_up(log):
    """Simulated roads do not shake: without odometer the IMU alone takes gliding for standing."""
    line = imu_timeline(replace(log, odometer=log.odometer.iloc[:0]))
    speed = np.interp(
        line.t, log.reference["t"], np.hypot(log.reference["v_e"], log.reference["v_n"])
    )
    run = InsNavigator().run(line.samples, line.fixes, line.timing)
    fast = torch.tensor(speed[run.first :] > 2.0)
    assert float(line.samples.stationary[run.first :][fast].mean()) > 0.1
    assert float(run.samples.stationary[fast].mean()) < 0.01
    assert float(horizontal_error(log, line, run.first, run.history.trajectory).max()) < 8.0


def test_sigma_points_take_the_filters_place(log, line, run):
    options = InsEkfOptions(unscented=UnscentedOptions())
    navigator = InsNavigator(InsNavigatorOptions(filter=options))
    points = navigator.run(line.samples, line.fixes, line.timing)
    assert isinstance(navigator.filter, InsUkf)
    assert points.history.method == "fast"
    gap = torch.stack(enu_between(*points.history.trajectory[:3], *run.history.trajectory[:3]))
    # at 20 Hz the two tell the same car
    assert 1e-6 < float(gap.norm(dim=0).max()) < 1.0
    error = horizontal_error(log, line, points.first, points.history.trajectory)
    assert float(error[200:].median()) < 2.0
    smoothed = navigator.smooth(points, line.fixes, line.timing)
    error = horizontal_error(log, line, points.first, smoothed.trajectory)
    assert float(error.median()) < 2.0
