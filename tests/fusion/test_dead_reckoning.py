"""Dead reckoning's start against drives whose bias, scale and azimuth are known."""

import math

import pytest
import torch

from navlearn import wgs84
from navlearn.attitude import matrix_from_angles
from navlearn.errors import LogError
from navlearn.frames import enu_between
from navlearn.fusion.dead_reckoning import (
    DeadReckoningOptions,
    dead_reckoning_start,
    fit_course,
    odometer_scale_from_gnss,
)
from navlearn.states import FixTiming, GnssFix, RissSample

RATE = 10
BIAS = math.radians(0.3)
SCALE = -0.02
LAT = math.radians(45.0)


def winding_drive(
    seconds: int = 200, noise: float = 0.0
) -> tuple[RissSample, GnssFix, FixTiming, torch.Tensor]:
    """A car at 10 m/s on a sine of azimuth; gyro with a bias, odometer with a scale error."""
    generator = torch.Generator().manual_seed(3)
    t = torch.arange(seconds * RATE + 1, dtype=torch.float64) / RATE
    azimuth = 0.4 + 0.8 * torch.sin(0.1 * t)
    rate = -torch.diff(azimuth) * RATE
    count = len(rate)
    zero, one = torch.zeros(count, dtype=torch.float64), torch.ones(count, dtype=torch.float64)
    samples = RissSample(
        one / RATE, rate + BIAS, 10.0 * (1.0 + SCALE) * one, zero, zero, zero, zero, zero
    )
    index = torch.arange(RATE - 1, count, RATE)
    truth = azimuth[index + 1] + noise * torch.randn(
        len(index), dtype=torch.float64, generator=generator
    )
    ones = torch.ones(len(index), dtype=torch.float64)
    fixes = GnssFix(
        LAT * ones, 0.2 * ones, 100.0 * ones,
        10.0 * torch.sin(truth), 10.0 * torch.cos(truth), 0.0 * ones,
        ones, ones, ones, 0.1 * ones, ones, ones,
    )  # fmt: skip
    return samples, fixes, FixTiming(index, torch.zeros_like(ones)), azimuth


def test_course_fit_finds_azimuth_and_bias_exactly_without_noise():
    samples, fixes, timing, azimuth = winding_drive()
    found, bias, used = fit_course(samples, fixes, timing, DeadReckoningOptions())
    assert used == 120
    assert float(bias) == pytest.approx(BIAS, rel=1e-9)
    assert float(found) == pytest.approx(float(azimuth[-1]), abs=1e-9)


def test_course_fit_shrugs_off_a_few_wild_courses():
    samples, fixes, timing, azimuth = winding_drive(noise=0.002)
    wild = fixes.v_e.clone()
    wild[[100, 130, 160]] += 40.0
    found, bias, _ = fit_course(samples, fixes._replace(v_e=wild), timing, DeadReckoningOptions())
    assert float(bias) == pytest.approx(BIAS, abs=math.radians(0.005))
    assert float(found) == pytest.approx(float(azimuth[-1]), abs=0.003)


def test_delay_of_fixes_is_taken_into_account():
    samples, fixes, timing, azimuth = winding_drive()
    late = timing._replace(delay=torch.full_like(timing.delay, 0.05))
    at = azimuth[timing.index + 1] + samples.yaw_rate[timing.index] * 0.05 - BIAS * 0.05
    moved = fixes._replace(v_e=10.0 * torch.sin(at), v_n=10.0 * torch.cos(at))
    found, bias, _ = fit_course(samples, moved, late, DeadReckoningOptions())
    assert float(bias) == pytest.approx(BIAS, rel=1e-9)
    assert float(found) == pytest.approx(float(azimuth[-1]), abs=1e-9)


def test_scale_is_the_ratio_of_speeds():
    samples, fixes, timing, _ = winding_drive()
    assert float(odometer_scale_from_gnss(samples, fixes, timing, 3.0)) == pytest.approx(SCALE)
    assert float(odometer_scale_from_gnss(samples, fixes, timing, 50.0)) == 0.0


def test_start_is_the_last_fix():
    samples, fixes, timing, azimuth = winding_drive()
    start = dead_reckoning_start(samples, fixes, timing, DeadReckoningOptions())
    assert start.sample == int(timing.index[-1])
    assert float(start.state.lat) == pytest.approx(LAT)
    assert float(start.state.azimuth) == pytest.approx(float(azimuth[-1]), abs=1e-9)


def test_few_moving_fixes_fall_back_on_the_bias_at_rest():
    samples, fixes, timing, _ = winding_drive()
    rest = torch.zeros_like(samples.dt)
    rest[:100] = 1.0
    still = torch.where(rest > 0, BIAS + wgs84.EARTH_RATE * math.sin(LAT), samples.yaw_rate)
    samples = samples._replace(stationary=rest, yaw_rate=still)
    options = DeadReckoningOptions(window=10.0)
    _, bias, used = fit_course(samples, fixes, timing, options)
    assert used == 1
    assert float(bias) == pytest.approx(BIAS, rel=1e-9)


def test_without_a_course_the_error_says_what_to_do():
    samples, fixes, timing, _ = winding_drive()
    parked = fixes._replace(v_e=0.0 * fixes.v_e, v_n=0.0 * fixes.v_n)
    with pytest.raises(LogError, match="no fix faster than 3 m/s"):
        dead_reckoning_start(samples, parked, timing, DeadReckoningOptions())
    nowhere = fixes._replace(has_position=0.0 * fixes.lat)
    with pytest.raises(LogError, match="no fix with a position"):
        dead_reckoning_start(samples, nowhere, timing, DeadReckoningOptions())


def test_the_lever_arm_is_taken_off_the_antenna():
    samples, fixes, timing, azimuth = winding_drive()
    arm = (0.5, 2.0, 1.5)
    bare = dead_reckoning_start(samples, fixes, timing, DeadReckoningOptions()).state
    moved = dead_reckoning_start(samples, fixes, timing, DeadReckoningOptions(lever_arm=arm)).state
    angles = (azimuth[-1], torch.zeros_like(azimuth[-1]), torch.zeros_like(azimuth[-1]))
    antenna = matrix_from_angles(*angles) @ torch.tensor(arm, dtype=torch.float64)
    found = torch.stack(enu_between(*bare[:3], *moved[:3]))
    torch.testing.assert_close(found, antenna, atol=1e-6, rtol=0.0)


def test_positions_alone_tell_no_course():
    samples, fixes, timing, _ = winding_drive()
    positions = fixes._replace(has_velocity=torch.zeros_like(fixes.has_velocity))
    with pytest.raises(LogError, match=r"no fix before the outage has a velocity.*tc_ekf"):
        fit_course(samples, positions, timing, DeadReckoningOptions())
