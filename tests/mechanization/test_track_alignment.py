"""Alignment by the way driven, against ways that are drawn here and against simulated drives."""

import math

import numpy as np
import pytest
import torch

from navlearn import wgs84
from navlearn.errors import ConfigError, LogError
from navlearn.frames import enu_between
from navlearn.logs.reference import reference_at
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.alignment import AlignmentOptions, TrackOptions
from navlearn.mechanization.track_alignment import align_from_track, align_riss
from navlearn.mechanization.track_fit import (
    Positions,
    Prior,
    Way,
    _residual,  # the derivatives of the fit
    fit_track,
    way_back,
)
from navlearn.states import FixTiming, GnssFix, RissSample

LAT, LON = math.radians(52.5), math.radians(13.4)
BIAS = math.radians(0.2)
STEP = 0.1


def drawn(seconds=60.0, seed=0, curve=0.05):
    """Return true azimuth, east and north at every 0.1 s and the samples of a drive that turns."""
    rng = np.random.default_rng(seed)
    t = np.arange(1, round(seconds / STEP) + 1) * STEP
    speed = 8.0 + 3.0 * np.sin(0.2 * t)
    rate = curve * np.sin(0.15 * t + rng.uniform(0.0, 6.0))
    azimuth = rng.uniform(0.0, 2.0 * math.pi) + np.cumsum(rate) * STEP
    middle = azimuth - 0.5 * STEP * rate
    east = np.cumsum(speed * np.sin(middle)) * STEP
    north = np.cumsum(speed * np.cos(middle)) * STEP
    return t, azimuth, east, north, speed, rate


def tensor(values):
    return torch.tensor(np.array(values), dtype=torch.float64)


def on_the_ground(t, azimuth, east, north, speed, rate, error_e=0.0, error_n=0.0, every=10):
    """Return samples and fixes of a drawn drive; fixes have no velocity."""
    zero = np.zeros(t.size)
    earth = wgs84.EARTH_RATE * math.sin(LAT)
    samples = RissSample(
        *map(tensor, (zero + STEP, earth + BIAS - rate, speed, zero, zero, zero, zero, zero))
    )
    m = np.arange(every - 1, t.size, every)
    w = 1.0 - wgs84.ECCENTRICITY_SQUARED * math.sin(LAT) ** 2
    r_n = wgs84.SEMI_MAJOR_AXIS / math.sqrt(w)
    r_m = r_n * (1.0 - wgs84.ECCENTRICITY_SQUARED) / w
    lat = LAT + (north[m] + error_n) / r_m
    lon = LON + (east[m] + error_e) / (r_n * math.cos(LAT))
    one, nil = np.ones(m.size), np.zeros(m.size)
    fixes = GnssFix(
        *map(tensor, (lat, lon, nil, nil, nil, nil, 3 * one, 4 * one, 6 * one, one, one, nil))
    )
    return samples, fixes, FixTiming(torch.tensor(m), tensor(nil))


def test_a_way_without_errors_is_found_exactly():
    for seed in range(5):
        drive = drawn(seed=seed, seconds=60.0 + seed)
        samples, fixes, timing = on_the_ground(*drive)
        options = AlignmentOptions(track=TrackOptions(least_time=55.0))
        found = align_from_track(samples, fixes, timing, options)
        k = found.sample
        assert STEP * k == pytest.approx(55.0, abs=1.1)
        wrong = math.remainder(float(found.state.azimuth) - drive[1][k], 2.0 * math.pi)
        # the prior on the gyro bias (0.5 degrees per second) pulls a little
        assert abs(wrong) < 1e-3
        assert found.gyro_bias == pytest.approx(BIAS, abs=1e-4)
        east = (float(found.state.lon) - LON) * 6.38e6 * math.cos(LAT)
        assert east == pytest.approx(drive[2][k], rel=5e-3, abs=0.1)
        assert found.position_sigma >= 4.0
        assert found.height_sigma == 6.0


def test_where_the_car_was_and_what_a_bias_does():
    """Against a sum over intervals, one by one, and against numerical derivatives."""
    t, azimuth, east, north, speed, rate = drawn(seconds=20.0)
    way = Way(tensor(np.full(t.size, STEP)), tensor(rate), tensor(speed))
    times = tensor([0.0, 3.14, 10.0, 20.0])
    back, by_bias = way_back(way, times, tensor(0.0))
    s, c = math.sin(azimuth[-1]), math.cos(azimuth[-1])
    at_e = np.interp(times, np.r_[0.0, t], np.r_[0.0, east]) - east[-1]
    at_n = np.interp(times, np.r_[0.0, t], np.r_[0.0, north]) - north[-1]
    np.testing.assert_allclose(back[0], c * at_e - s * at_n, atol=1e-9)
    np.testing.assert_allclose(back[1], s * at_e + c * at_n, atol=1e-9)
    more, less = (way_back(way, times, tensor(b))[0] for b in (1e-6, -1e-6))
    np.testing.assert_allclose(by_bias, (more - less) / 2e-6, rtol=1e-6, atol=1e-4)
    unknown = tensor([3.0, -2.0, 1.0, 0.01, 0.02])
    seen = Positions(times, times, times, torch.ones_like(times))
    design = _residual(way, seen, unknown)[1]
    by_hand = torch.autograd.functional.jacobian(lambda x: -_residual(way, seen, x)[0], unknown)
    np.testing.assert_allclose(design, by_hand, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("correlation", [0.0, 10.0])
def test_deviations_are_those_of_many_draws(correlation):
    """White and correlated errors of 3 m; what is told must bound what is seen."""
    t, azimuth, east, north, speed, rate = drawn(seconds=60.0, seed=3)
    way = Way(tensor(np.full(t.size, STEP)), tensor(rate + BIAS), tensor(speed))
    m = np.arange(4, t.size, 5)
    keep = math.exp(-0.5 / correlation) if correlation else 0.0
    rng = np.random.default_rng(5)
    wrong = []
    for _ in range(80):
        noise = rng.standard_normal((2, m.size))
        for k in range(1, m.size):
            noise[:, k] = keep * noise[:, k - 1] + math.sqrt(1.0 - keep**2) * noise[:, k]
        seen = Positions(
            tensor(t[m]), tensor(east[m] + 3.0 * noise[0]), tensor(north[m] + 3.0 * noise[1]),
            tensor(np.full(m.size, 3.0)),
        )  # fmt: skip
        prior = Prior(-BIAS, math.radians(0.1), 0.01)
        found = fit_track(way, seen, prior, huber=1.5, correlation_time=10.0)
        error = torch.stack((found.east - east[-1], found.north - north[-1]))
        turn = math.remainder(float(found.azimuth) - azimuth[-1], 2.0 * math.pi)
        deviation = found.covariance.diagonal().sqrt()
        wrong.append([*(error / deviation[:2]).tolist(), turn / float(deviation[2])])
    size = np.sqrt(np.mean(np.square(wrong), axis=0))
    # sensors are perfect here, and white errors average better than what is allowed for
    low = 0.55 if correlation else 0.1
    assert (size > low).all(), size
    assert (size < 1.25).all(), size


def test_wild_positions_hardly_turn_it():
    drive = drawn(seconds=80.0, seed=8)
    count = drive[0].size // 10
    off = np.where(np.arange(count) % 5 == 2, 300.0, 0.0)
    found = align_from_track(*on_the_ground(*drive, error_e=off), AlignmentOptions())
    wrong = float(found.state.azimuth) - drive[1][found.sample]
    assert abs(math.remainder(wrong, 2.0 * math.pi)) < math.radians(1.0)


def test_nothing_after_the_end_is_looked_at():
    drive = drawn(seconds=100.0, seed=4)
    samples, fixes, timing = on_the_ground(*drive, error_n=2.0 * np.sin(np.arange(100)))
    found = align_from_track(samples, fixes, timing, AlignmentOptions())
    k = found.sample
    assert k < 600
    poisoned = samples._replace(
        yaw_rate=torch.where(torch.arange(len(samples.dt)) > k, 9.0, samples.yaw_rate)
    )
    moved = fixes._replace(lat=torch.where(timing.index > k, 0.0, fixes.lat))
    again = align_from_track(poisoned, moved, timing, AlignmentOptions())
    assert again == found


def test_the_way_is_asked_only_where_no_fix_has_a_velocity():
    samples, fixes, timing = on_the_ground(*drawn())
    one = torch.ones_like(fixes.lat)
    told = fixes._replace(v_e=0.0 * one, v_n=10.0 * one, has_velocity=one)
    assert float(align_riss(samples, told, timing, AlignmentOptions()).state.azimuth) == 0.0
    assert align_riss(samples, fixes, timing, AlignmentOptions()).sample > 100
    none = GnssFix(*(channel[:0] for channel in fixes))
    nowhere = FixTiming(*(channel[:0] for channel in timing))
    with pytest.raises(LogError, match="with_single_point_fixes"):
        align_riss(samples, none, nowhere, AlignmentOptions())


def test_too_short_a_way_is_refused():
    samples, fixes, timing = on_the_ground(*drawn())
    parked = samples._replace(speed=0.0 * samples.speed)
    with pytest.raises(LogError, match=r"the way driven \(0 m at most within 180 s\) tells"):
        align_from_track(parked, fixes, timing, AlignmentOptions())
    coarse = fixes._replace(std_e=500.0 * fixes.std_e, std_n=500.0 * fixes.std_n)
    with pytest.raises(LogError, match=r"rad at best where 0\.175 rad are asked; give a longer"):
        align_from_track(samples, coarse, timing, AlignmentOptions())


@pytest.mark.parametrize(
    "entry",
    [
        {"correlation_time": 0.0},
        {"least_fixes": 2},
        {"huber": -1.0},
        {"azimuth_sigma": math.nan},
        {"least_way": -1.0},
        {"longest": math.inf},
    ],
)
def test_options_without_meaning(entry):
    (name,) = entry
    with pytest.raises(ConfigError, match=rf"track\.{name}: found .*; expected"):
        TrackOptions(**entry)
    TrackOptions(least_way=0.0, least_time=0.0, every=0.0, least_fixes=3)


def normalised(seed, starts, duration):
    """Return errors over deviations of a simulated drive, aligned anew from several starts."""
    drive = simulate_drive(
        profile="mixed", grade="mems_m", duration=duration, seed=seed, imu_rate_hz=20.0
    )
    fixes = drive.log.fixes.drop(columns=["v_e", "v_n", "v_u"])
    line = riss_timeline(drive.log.with_tables({"fixes": fixes}), rate_hz=10.0)
    found = []
    for start in starts:
        first = int((line.t > start).nonzero()[0])
        later = line.timing.index >= first
        got = align_riss(
            RissSample(*(channel[first:] for channel in line.samples)),
            GnssFix(*(channel[later] for channel in line.fixes)),
            FixTiming(line.timing.index[later] - first, line.timing.delay[later]),
            AlignmentOptions(),
        )
        truth = reference_at(drive.log, line.t[[first + got.sample]]).iloc[0]
        there = [torch.tensor(float(truth[name])) for name in ("lat", "lon", "height")]
        east, north, _ = enu_between(got.state.lat, got.state.lon, there[2], *there)
        turn = math.remainder(float(got.state.azimuth) - truth["azimuth"], 2.0 * math.pi)
        sigma = got.position_sigma
        found.append((turn / got.azimuth_sigma, float(east) / sigma, float(north) / sigma))
    return found


@pytest.mark.parametrize("seed", [11, pytest.param(12, marks=pytest.mark.slow)])
def test_simulated_drives_lie_within_their_deviations(seed):
    wrong = np.array(normalised(seed, np.arange(60.0, 500.0, 60.0), 620.0))
    size = np.sqrt(np.mean(wrong**2, axis=0))
    assert (size < 1.5).all(), size
    assert (np.abs(wrong) < 3.0).all()


@pytest.mark.slow
def test_all_tuning_drives():
    wrong = [
        row for seed in range(11, 17) for row in normalised(seed, np.arange(60, 1300, 110), 1500)
    ]
    size = np.sqrt(np.mean(np.square(wrong), axis=0))
    assert (size > 0.2).all(), size
    assert (size < 1.15).all(), size
