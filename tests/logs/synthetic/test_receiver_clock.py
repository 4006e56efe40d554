"""The receiver's clock beside the covariance of its two-state model."""

from dataclasses import replace

import numpy as np
import pytest

from navlearn.gnss.signals import SPEED_OF_LIGHT
from navlearn.logs.synthetic.receiver_clock import receiver_clock
from navlearn.logs.synthetic.satellite_options import SatelliteOptions

STILL = SatelliteOptions(clock=0.0, clock_rate=0.0, clock_white=0.0, clock_walk=0.0)


def test_without_noise_it_runs_evenly() -> None:
    found = receiver_clock(50, 0.5, options=replace(STILL, clock=-300.0, clock_rate=7.0), seed=1)
    np.testing.assert_allclose(found.offset, -300.0 + 7.0 * 0.5 * np.arange(50))
    np.testing.assert_array_equal(found.rate, np.full(50, 7.0))


def test_spread_after_a_while_is_that_of_the_model() -> None:
    asked = replace(STILL, clock_white=0.5, clock_walk=0.1)
    ends = np.array(
        [[part[-1] for part in receiver_clock(61, 1.0, options=asked, seed=s)] for s in range(1500)]
    )
    t = 60.0
    expected = np.array(
        (
            (0.25 * t + 0.01 * t**3 / 3.0, 0.01 * t**2 / 2.0),
            (0.01 * t**2 / 2.0, 0.01 * t),
        )
    )
    np.testing.assert_allclose(np.cov(ends.T), expected, rtol=0.12)


def test_halving_the_interval_changes_nothing_but_the_draw() -> None:
    asked = replace(STILL, clock_white=0.5, clock_walk=0.1)
    spread = [
        np.std([receiver_clock(n, dt, options=asked, seed=s).offset[-1] for s in range(800)])
        for n, dt in ((11, 2.0), (41, 0.5))
    ]
    assert spread[0] == pytest.approx(spread[1], rel=0.1)


def test_steering_keeps_it_within_half_a_step() -> None:
    asked = replace(SatelliteOptions(), clock=0.0, clock_rate=4000.0, clock_jump=1e-3)
    free = receiver_clock(600, 1.0, options=replace(asked, clock_jump=0.0), seed=2)
    found = receiver_clock(600, 1.0, options=asked, seed=2)
    step = 1e-3 * SPEED_OF_LIGHT
    assert np.abs(found.offset).max() <= 0.5 * step
    taken = (free.offset - found.offset) / step
    np.testing.assert_allclose(taken, np.round(taken), atol=1e-9)
    assert set(np.diff(np.round(taken))) == {0.0, 1.0}
    np.testing.assert_array_equal(found.rate, free.rate)
