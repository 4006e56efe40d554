"""Alignment against a car that stands, then drives off in a known direction."""

import math

import pytest
import torch

from navlearn import wgs84
from navlearn.errors import LogError
from navlearn.mechanization.alignment import (
    AlignmentOptions,
    align_from_course,
    gyro_bias_at_rest,
)
from navlearn.states import FixTiming, GnssFix, RissSample

BIAS = math.radians(0.4)
LAT = math.radians(56.0)
COURSE = math.radians(120.0)


def stand_and_go(rest: int = 30, drive: int = 20) -> tuple[RissSample, GnssFix, FixTiming]:
    """Intervals of 1 s: at rest, then 10 m/s along one course."""
    moving = torch.tensor([0.0] * rest + [1.0] * drive, dtype=torch.float64)
    one, zero = torch.ones_like(moving), torch.zeros_like(moving)
    gyro = (BIAS + wgs84.EARTH_RATE * math.sin(LAT)) * one
    samples = RissSample(one, gyro, 10.0 * moving, zero, zero, zero, zero, 1.0 - moving)
    fixes = GnssFix(
        LAT * one, 0.3 * one, 50.0 * one,
        10.0 * moving * math.sin(COURSE), 10.0 * moving * math.cos(COURSE), zero,
        2.0 * one, 3.0 * one, 4.0 * one, 0.1 * one, one, one,
    )  # fmt: skip
    return samples, fixes, FixTiming(torch.arange(len(moving)), zero)


def test_starts_at_the_first_fast_fix_with_its_course():
    samples, fixes, timing = stand_and_go()
    found = align_from_course(samples, fixes, timing, AlignmentOptions())
    assert found.sample == 30
    assert float(found.state.azimuth) == pytest.approx(COURSE)
    assert found.azimuth_sigma == pytest.approx(2.0 * 0.1 / 10.0)
    assert found.position_sigma == 3.0
    assert found.gyro_bias == pytest.approx(BIAS, rel=1e-9)
    assert found.gyro_bias_sigma == AlignmentOptions().bias_sigma_at_rest


def test_a_short_rest_is_not_trusted():
    samples, fixes, timing = stand_and_go(rest=5)
    found = align_from_course(samples, fixes, timing, AlignmentOptions())
    assert found.gyro_bias == 0.0
    assert found.gyro_bias_sigma == AlignmentOptions().bias_sigma


def test_reversing_and_odometer_slip_do_not_align():
    samples, fixes, timing = stand_and_go()
    backwards = samples._replace(speed=-samples.speed)
    with pytest.raises(LogError, match="no fix with position and velocity"):
        align_from_course(backwards, fixes, timing, AlignmentOptions())


def test_a_fix_before_the_interval_end_is_carried_forward():
    samples, fixes, timing = stand_and_go()
    late = timing._replace(delay=0.5 * torch.ones_like(timing.delay))
    found = align_from_course(samples, fixes, late, AlignmentOptions())
    east = (float(found.state.lon) - 0.3) * wgs84.SEMI_MAJOR_AXIS * math.cos(LAT)
    north = (float(found.state.lat) - LAT) * wgs84.SEMI_MAJOR_AXIS
    assert east == pytest.approx(5.0 * math.sin(COURSE), rel=1e-3)
    assert north == pytest.approx(5.0 * math.cos(COURSE), rel=1e-3)
    turned = -float(samples.yaw_rate[30]) * 0.5
    assert float(found.state.azimuth) == pytest.approx(COURSE + turned)


def test_bias_at_rest_ignores_what_comes_later():
    samples, _, _ = stand_and_go()
    poisoned = samples.yaw_rate.clone()
    poisoned[20:] = 99.0
    lat = torch.tensor(LAT, dtype=torch.float64)
    bias, rest = gyro_bias_at_rest(samples._replace(yaw_rate=poisoned), lat, 20)
    assert bias == pytest.approx(BIAS, rel=1e-9)
    assert rest == 20.0
    assert gyro_bias_at_rest(samples, lat, 0) == (0.0, 0.0)
