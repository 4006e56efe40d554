"""Levelling against attitudes that the forces were made from."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from navlearn import earth, wgs84
from navlearn.attitude import matrix_from_angles
from navlearn.mechanization.levelling import TRIM, gyro_bias_at_rest, last_rest, tilt_at_rest
from navlearn.states import ImuSample


def tensor(*values):
    return torch.tensor(values, dtype=torch.float64)


LAT = tensor(0.8)[0]


@given(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.0, 3.0))
def test_the_tilt_that_made_the_force_comes_back(azimuth, pitch, roll):
    C_lb = matrix_from_angles(*tensor(azimuth, pitch, roll))
    f_b = C_lb.T @ tensor(0.0, 0.0, 9.8)
    found = tilt_at_rest(f_b)
    assert float(found[0]) == pytest.approx(pitch, abs=1e-9)
    assert float(found[1]) == pytest.approx(roll, abs=1e-9)


def test_a_bias_tips_by_its_share_of_gravity():
    pitch, roll = tilt_at_rest(tensor(0.05, 0.1, 9.8))
    assert float(pitch) == pytest.approx(0.1 / 9.8, rel=1e-3)
    assert float(roll) == pytest.approx(-0.05 / 9.8, rel=1e-3)


def test_gyros_at_rest_read_bias_and_earth_rate():
    angles = tensor(0.7, 0.05, -0.03)
    C_lb, bias = matrix_from_angles(*angles), tensor(1e-3, -2e-3, 3e-3)
    f_b = C_lb.T @ tensor(0.0, 0.0, 9.8)
    read = bias + C_lb.T @ earth.earth_rate_enu(LAT)
    exact = gyro_bias_at_rest(read, f_b, LAT, angles[0])
    assert torch.allclose(exact, bias, rtol=0.0, atol=1e-15)
    rough = gyro_bias_at_rest(read, f_b, LAT)
    assert 1e-6 < float((rough - bias).norm()) < wgs84.EARTH_RATE * math.cos(0.8) * 1.001


def standing(*lengths):
    """Intervals of 0.1 s: standing and moving in turn; each channel counts the stretches."""
    still = torch.cat(
        [torch.full((round(n * 10),), float(k % 2 == 0)) for k, n in enumerate(lengths)]
    )
    number = torch.cat([torch.full((round(n * 10),), float(k)) for k, n in enumerate(lengths)])
    dt = torch.full_like(still, 0.1, dtype=torch.float64)
    vector = number.to(dt).unsqueeze(-1).repeat(1, 3)
    return ImuSample(dt, vector, 10.0 + vector, 0.0 * dt, 0.0 * dt, still.to(dt))


def test_the_last_long_standstill_is_used_less_its_end():
    samples = standing(20, 10, 15, 10, 5, 10)
    rest = last_rest(samples, 700, 10.0)
    assert rest is not None
    assert (rest.first, rest.last) == (300, 449 - round(TRIM * 10))
    assert rest.duration == pytest.approx(15.0 - TRIM)
    assert rest.omega_ib_b.tolist() == pytest.approx([2.0] * 3)
    assert rest.f_b.tolist() == pytest.approx([12.0] * 3)


def test_nothing_after_the_end_counts():
    samples = standing(20, 10, 15)
    rest = last_rest(samples, 350, 10.0)
    assert rest is not None
    assert rest.omega_ib_b.tolist() == pytest.approx([0.0] * 3)
    assert last_rest(samples, 50, 10.0) is None
    assert last_rest(samples, 0, 10.0) is None
