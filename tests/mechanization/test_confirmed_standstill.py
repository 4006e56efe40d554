"""A standstill that only an IMU claims, against what fixes say."""

import pytest
import torch

from navlearn.mechanization.confirmed_standstill import confirmed_standstill
from navlearn.states import FixTiming, GnssFix, ImuSample

TENTHS = 600


def claimed(speed, *, has_speed=0.0, fixes_until=60.0):
    """60 s at 10 Hz, all claimed to be still, with a fix every second; speed is of time in s."""
    t = (torch.arange(TENTHS, dtype=torch.float64) + 1.0) / 10.0
    one = torch.ones_like(t)
    vector = torch.zeros(TENTHS, 3, dtype=torch.float64)
    samples = ImuSample(0.1 * one, vector, vector, 0.0 * one, has_speed * one, one)
    index = torch.arange(9, TENTHS, 10)
    index = index[t[index] <= fixes_until + 1e-9]
    told = torch.tensor([speed(float(x)) for x in t[index]], dtype=torch.float64)
    zero, full = torch.zeros_like(told), torch.ones_like(told)
    fixes = GnssFix(
        zero, zero, zero, 0.6 * told, 0.8 * told, zero, full, full, full, 0.1 * full, full, full
    )
    timing = FixTiming(index, zero)
    return confirmed_standstill(samples, fixes, timing).stationary, t


def test_fixes_of_a_standing_car_change_nothing():
    still, _ = claimed(lambda t: 0.1)
    assert bool((still == 1.0).all())


def test_a_car_that_just_drove_cannot_have_stopped():
    """One fast fix: 10 m/s takes 1.9 s to brake off to 0.5 m/s."""
    still, t = claimed(lambda t: 10.0 if abs(t - 30.0) < 0.5 else 0.0, fixes_until=30.0)
    denied = (still == 0.0).nonzero()[:, 0]
    assert t[denied[0]] == pytest.approx(30.0)
    assert t[denied[-1]] == pytest.approx(31.8, abs=0.11)


def test_a_detector_that_was_often_wrong_is_asked_no_more():
    still, t = claimed(lambda t: 8.0 if t < 20.0 else 0.0, fixes_until=40.0)
    assert bool((still[(t >= 1.0) & (t < 20.0)] == 0.0).all())
    # Standing fixes vouch for it, two seconds each; then it is on its own again.
    assert bool((still[(t >= 20.0) & (t < 41.9)] == 1.0).all())
    assert bool((still[t > 42.1] == 0.0).all())


def test_an_odometer_outranks_fixes():
    still, _ = claimed(lambda t: 8.0, has_speed=1.0)
    assert bool((still == 1.0).all())


def test_without_fixes_nothing_is_known():
    still, _ = claimed(lambda t: 8.0, fixes_until=0.0)
    assert bool((still == 1.0).all())


def test_later_fixes_do_not_reach_back():
    one, t = claimed(lambda t: 8.0 if t < 30.0 else 0.0)
    other, _ = claimed(lambda t: 8.0)
    assert torch.equal(one[t < 29.95], other[t < 29.95])
