"""The standstill detector on signals made by hand: sensors' noise, engines, roads, curves."""

import math

import numpy as np
import pytest

from navlearn.logs.ins_standstill import InsStandstillOptions, standstill_intervals

RATE = 100.0
DT = 1.0 / RATE
GRAVITY = np.array([0.1, 0.2, 9.8])
BIAS = np.array([0.004, -0.006, 0.005])


def road(rng, shape, spread):
    """Return body motion of a few hertz: noise through a slow low-pass, scaled to its spread."""
    kernel = np.exp(-np.arange(60) / 6.0)
    wave = np.stack(
        [np.convolve(rng.standard_normal(shape[0] + 60), kernel)[60:-59] for _ in "xyz"]
    )
    return spread * (wave / wave.std(axis=1, keepdims=True)).T


def drive(*stretches, force_noise=0.02, rate_noise=0.001, engine=0.0, seed=3):
    """Return rate, force and truth of stretches: (length in s, whether moving)."""
    rng = np.random.default_rng(seed)
    moving = np.concatenate([np.full(round(length * RATE), go) for length, go in stretches])
    shape = (moving.size, 3)
    shaken = np.where(moving, 1.0, 0.0)[:, None]
    t = np.arange(moving.size) * DT
    idle = engine * np.sin(2.0 * math.pi * 27.0 * t)[:, None]
    force = GRAVITY + force_noise * rng.standard_normal(shape) + road(rng, shape, 0.3) * shaken
    rate = BIAS + rate_noise * rng.standard_normal(shape) + road(rng, shape, 0.015) * shaken
    return rate, force + idle, moving


def underway(moving):
    """Return where the car has moved for a fifth of a second: setting off is noticed by then."""
    return moving & np.concatenate((np.zeros(20, dtype=bool), moving[:-20]))


@pytest.mark.parametrize(
    ("force_noise", "rate_noise"), [(0.003, 1e-4), (0.03, 0.002), (0.1, 0.0065)]
)
@pytest.mark.parametrize("start", [True, False])
def test_stops_are_found_whatever_the_sensor(force_noise, rate_noise, start):
    rate, force, moving = drive(
        (20, start), (15, False), (30, True), (10, False), (20, True),
        force_noise=force_noise, rate_noise=rate_noise,
    )  # fmt: skip
    still = standstill_intervals(DT, rate, force)
    assert not still[underway(moving)].any()
    for begin, end in ((20.0, 35.0), (65.0, 75.0)):
        found = np.flatnonzero(still[round(begin * RATE) : round(end * RATE)]) * DT
        assert found[0] < 2.5
        assert found.size * DT > 0.7 * (end - begin - 2.5)


def test_an_engine_is_no_road():
    rate, force, moving = drive((15, False), (20, True), (15, False), engine=0.3)
    still = standstill_intervals(DT, rate, force)
    assert still[~moving].mean() > 0.85
    assert not still[underway(moving)].any()


def test_a_steady_curve_is_no_stop_even_on_glass():
    rate, force, _ = drive((30, False), (20, False))
    rate[3000:, 2] += 0.05
    force[3000:, 0] += 0.5
    still = standstill_intervals(DT, rate, force)
    assert still[150:3000].all()
    assert not still[3010:].any()


def test_setting_off_is_noticed_at_once():
    rate, force, _ = drive((30, False), (5, False))
    t = np.arange(500) * DT
    force[3000:, 1] += 2.0 * np.minimum(t / 0.5, 1.0)
    still = standstill_intervals(DT, rate, force)
    last = np.flatnonzero(still)[-1] * DT - 30.0
    way_speed = np.cumsum(2.0 * np.minimum(t / 0.5, 1.0)) * DT
    assert 0.0 <= last < 0.3
    assert way_speed[max(round(last * RATE), 0)] < 0.15


def test_an_odometer_vetoes_and_vouches():
    rate, force, moving = drive((20, False), (20, False))
    speed = np.where(np.arange(moving.size) < 2000, 0.0, 5.0)
    told = np.ones(moving.size, dtype=bool)
    still = standstill_intervals(DT, rate, force, speed=speed, has_speed=told)
    assert still[150:2000].all()
    assert not still[2000:].any()
    silent = standstill_intervals(DT, rate, force, speed=speed, has_speed=~told)
    np.testing.assert_array_equal(silent, standstill_intervals(DT, rate, force))
    # A bus idles so roughly that its IMU alone would not be believed.
    rough = force + road(np.random.default_rng(8), force.shape, 0.12)
    assert standstill_intervals(DT, rate, rough).mean() < 0.2
    vouched = standstill_intervals(DT, rate, rough, speed=0.0 * speed, has_speed=told)
    assert vouched[150:].mean() > 0.9


def test_a_bridged_gap_is_neither_quiet_nor_still():
    rate, force, moving = drive((30, True), (10, False))
    gap = slice(1000, 1400)
    # A straight line between two samples has no spread at all.
    rate[gap], force[gap] = BIAS, GRAVITY
    measured = np.ones(moving.size, dtype=bool)
    assert standstill_intervals(DT, rate, force)[gap].any()
    measured[gap] = False
    still = standstill_intervals(DT, rate, force, measured=measured)
    assert not still[moving].any()
    assert still[3000:].sum() * DT > 6.0


@pytest.mark.parametrize("value", [99.0, np.nan])
def test_nothing_later_is_looked_at(value):
    rate, force, _ = drive((10, False), (10, True), (10, False))
    clean = standstill_intervals(DT, rate, force)
    for channel in (rate, force):
        spoilt = channel.copy()
        spoilt[2500:, 1] = value
        pair = (spoilt, force) if channel is rate else (rate, spoilt)
        np.testing.assert_array_equal(standstill_intervals(DT, *pair)[:2500], clean[:2500])


def test_growing_a_drive_changes_nothing():
    rate, force, _ = drive((12, False), (15, True), (12, False))
    whole = standstill_intervals(DT, rate, force)
    for count in (1, 50, 700, 2900):
        part = standstill_intervals(DT, rate[:count], force[:count])
        np.testing.assert_array_equal(part, whole[:count])
    assert standstill_intervals(DT, rate[:0], force[:0]).size == 0


def test_slow_logs_are_judged_by_more_samples():
    rate, force, moving = drive((40, False), (60, True), (40, False))
    slow = [x.reshape(-1, 100, 3).mean(1) for x in (rate, force)]
    still = standstill_intervals(1.0, *slow)
    truth = moving.reshape(-1, 100).any(1)
    assert not still[truth].any()
    assert still[~truth].mean() > 0.4


def test_limits_are_options():
    rate, force, _ = drive((20, False))
    assert standstill_intervals(DT, rate, force)[300:].all()
    strict = InsStandstillOptions(max_rate=0.001)
    assert not standstill_intervals(DT, rate, force, options=strict).any()
