"""The navigator on simulated drives, and its small geometry by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.errors import ConfigError, LogError
from navlearn.fusion.options import EkfOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline, riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.navigator import (
    Navigator,
    NavigatorOptions,
    belief_at,
    without_position_error,
)
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory

PLANE = EkfOptions(mechanization=RissOptions(dimensions=2), zero_yaw_rate=False)


@pytest.fixture(scope="module")
def log() -> DriveLog:
    return simulate_drive(
        profile="town", grade="mems_m", duration=240.0, seed=5, imu_rate_hz=20.0
    ).log


@pytest.fixture(scope="module")
def line(log: DriveLog) -> RissTimeline:
    return riss_timeline(log, rate_hz=10.0)


def before(line: RissTimeline, time: float) -> tuple[GnssFix, FixTiming]:
    kept = line.fix_time < time
    return (
        GnssFix(*(channel[kept] for channel in line.fixes)),
        FixTiming(line.timing.index[kept], line.timing.delay[kept]),
    )


@pytest.mark.parametrize("method", ["fast", "exact", "sequential"])
def test_it_starts_itself_and_follows_the_car(
    log: DriveLog, line: RissTimeline, method: str
) -> None:
    navigator = Navigator(NavigatorOptions(filter=PLANE, method=method))
    run = navigator.run(line.samples, line.fixes, line.timing)
    assert run.first == run.alignment.sample + 1
    assert run.samples.dt.shape == run.history.trajectory.lat.shape
    assert run.samples.dt.shape[-1] == line.t.shape[-1] - run.first
    assert torch.equal(run.samples.yaw_rate, line.samples.yaw_rate[run.first :])
    truth = log.reference
    assert truth is not None
    t = line.t[run.first :].numpy()
    late = t > t[0] + 60.0
    for name, scale, limit in (("lat", 6.37e6, 6.0), ("azimuth", 180.0 / math.pi, 4.0)):
        known = np.interp(t, truth["t"], np.unwrap(truth[name]))
        error = getattr(run.history.trajectory, name).numpy() - known
        error = (error + math.pi) % (2.0 * math.pi) - math.pi
        assert np.abs(error * scale)[late].max() < limit, name


def test_it_says_when_the_car_never_drove(line: RissTimeline) -> None:
    fixes, timing = before(line, 20.0)  # the first half minute is a standstill
    with pytest.raises(LogError, match="alignment"):
        Navigator(NavigatorOptions(filter=PLANE)).run(line.samples, fixes, timing)


def test_a_fix_before_the_alignment_does_not_reach_the_filter(line: RissTimeline) -> None:
    navigator = Navigator(NavigatorOptions(filter=PLANE))
    run = navigator.run(line.samples, line.fixes, line.timing)
    first = int(run.history.fix[run.history.fix >= 0][0])
    later = line.timing.index[line.timing.index >= run.first]
    assert int(run.history.end[run.history.fix == first][0]) == int(later[0]) - run.first


def test_coasting_is_what_the_filter_predicts_without_fixes(line: RissTimeline) -> None:
    navigator = Navigator(NavigatorOptions(filter=PLANE))
    fixes, timing = before(line, 180.0)
    run = navigator.run(line.samples, fixes, timing)
    block = int(torch.nonzero(run.history.fix >= 0)[-1])
    gone = int(run.history.end[block]) + 1
    samples = RissSample(*(channel[gone:] for channel in run.samples))
    belief = belief_at(run.history, block)
    coasted = navigator.coast(belief, samples)
    filtered = navigator.filter_on(belief, samples, torch.zeros_like(samples.dt)).trajectory
    assert samples.dt.shape[-1] > 500
    for name in ("lat", "lon", "azimuth", "v_e", "v_n"):
        expected = getattr(run.history.trajectory, name)[gone:]
        for found in (coasted, filtered):
            assert torch.allclose(getattr(found, name), expected, rtol=0.0, atol=1e-8), name


def test_a_yaw_rate_error_is_taken_off(line: RissTimeline) -> None:
    navigator = Navigator(NavigatorOptions(filter=PLANE))
    run = navigator.run(line.samples, *before(line, 180.0))
    block = torch.nonzero(run.history.fix >= 0)[-1:, 0]  # a batch of one
    gone = int(run.history.end[block]) + 1
    samples = RissSample(*(channel[gone:].unsqueeze(0) for channel in run.samples))
    belief = belief_at(run.history, block)
    error = 0.01 * torch.sin(torch.arange(samples.dt.shape[-1], dtype=torch.float64))
    spoilt = samples._replace(yaw_rate=samples.yaw_rate + error)
    clean = navigator.coast(belief, samples)
    assert (navigator.coast(belief, spoilt).azimuth - clean.azimuth).abs().max() > 1e-3
    mended = navigator.coast(belief, spoilt, error.unsqueeze(0))
    for found, expected in zip(mended, clean, strict=True):
        assert torch.allclose(found, expected, rtol=0.0, atol=1e-12)
    one = RissSample(*(channel[0] for channel in spoilt))
    again = navigator.filter_on(belief_at(run.history, int(block)), one, error).trajectory
    assert torch.allclose(again.azimuth, clean.azimuth[0], rtol=0.0, atol=1e-8)


def test_models_with_velocity_states_cannot_coast(line: RissTimeline) -> None:
    options = replace(PLANE, model="shen2010_full")
    navigator = Navigator(NavigatorOptions(filter=options))
    run = navigator.run(line.samples, line.fixes, line.timing)
    with pytest.raises(ConfigError, match="velocity as a state"):
        navigator.coast(belief_at(run.history, 0), run.samples)


def at_rest(lat: float, steps: int) -> Trajectory:
    zero = torch.zeros(steps, dtype=torch.float64)
    return Trajectory(zero + lat, zero - 1.3, zero + 90.0, zero, zero, zero, zero)


def radii(lat: float) -> tuple[float, float]:
    w = 1.0 - 0.0066943799901414 * math.sin(lat) ** 2
    return 6_378_137.0 * (1.0 - 0.0066943799901414) / w**1.5 + 90.0, 6_378_137.0 / w**0.5 + 90.0


def double(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_a_position_error_is_taken_off_where_the_car_points() -> None:
    """Error ahead while driving east, then to the right while driving east (that is south)."""
    lat = 0.77
    east = double(*(3 * [math.pi / 2]))
    better = without_position_error(
        at_rest(lat, 3), double(4.0, 0.0, 0.0), double(0.0, 6.0, 0.0), east
    )
    r_m, r_n = radii(lat)
    moved_east = (better.lon.numpy() + 1.3) * r_n * math.cos(lat)
    moved_north = (better.lat.numpy() - lat) * r_m
    np.testing.assert_allclose(moved_east, [-4.0, -4.0, -4.0], atol=1e-6)
    np.testing.assert_allclose(moved_north, [0.0, 6.0, 6.0], atol=1e-6)
    assert torch.equal(better.azimuth, at_rest(lat, 3).azimuth)
    assert torch.equal(better.height, at_rest(lat, 3).height)


def test_position_errors_of_a_turning_car_add_up_in_their_own_frames() -> None:
    """Ahead to the north-east, ahead to the north, right while driving north: by hand."""
    lat = -0.5
    better = without_position_error(
        at_rest(lat, 3),
        double(math.sqrt(2.0), 3.0, 0.0),
        double(0.0, 0.0, 5.0),
        double(math.pi / 4, 0.0, 0.0),
    )
    r_m, r_n = radii(lat)
    np.testing.assert_allclose((better.lat.numpy() - lat) * r_m, [-1.0, -4.0, -4.0], atol=1e-6)
    np.testing.assert_allclose(
        (better.lon.numpy() + 1.3) * r_n * math.cos(lat), [-1.0, -1.0, -6.0], atol=1e-6
    )


def test_it_warns_of_a_filter_that_climbs_on_level_samples(line: RissTimeline) -> None:
    with pytest.warns(UserWarning, match=r"dimensions=3, but no sample has pitch or roll"):
        Navigator(NavigatorOptions()).run(line.samples, line.fixes, line.timing)
