"""Statistics of the random processes against their theory."""

import math

import numpy as np
import pytest

from navlearn.logs.synthetic.draws import (
    gauss_markov,
    generator,
    random_walk,
    smooth_noise,
    white_noise,
)


def allan_deviation(rate: np.ndarray, dt: float, cluster: int) -> float:
    """Overlapping Allan deviation of a rate record (IEEE Std 952, Eq. C.9)."""
    theta = np.concatenate(([0.0], np.cumsum(rate) * dt))
    second = theta[2 * cluster :] - 2.0 * theta[cluster:-cluster] + theta[: -2 * cluster]
    return math.sqrt(float(np.mean(second**2)) / (2.0 * (cluster * dt) ** 2))


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_white_noise_follows_its_allan_slope(dt: float) -> None:
    density = math.radians(2.25) / 60.0
    rate = white_noise(generator(1, "white"), 400_000, density, dt)
    for tau in (1.0, 10.0):
        found = allan_deviation(rate, dt, round(tau / dt))
        assert found == pytest.approx(density / math.sqrt(tau), rel=0.05)


def test_random_walk_follows_its_allan_slope_and_grows_with_the_root_of_time() -> None:
    dt, density = 0.1, 3e-5
    walk = random_walk(generator(2, "walk"), 400_000, density, dt)
    found = allan_deviation(walk, dt, 1000)
    assert found == pytest.approx(density * math.sqrt(100.0 / 3.0), rel=0.15)
    ends = [random_walk(generator(s, "walk"), 500, density, dt)[[124, 499]] for s in range(800)]
    std = np.std(ends, axis=0)
    assert std == pytest.approx([density * math.sqrt(12.5), density * math.sqrt(50.0)], rel=0.08)


def test_gauss_markov_is_stationary_with_its_correlation_time() -> None:
    dt, std, tau = 0.5, 2.0, 20.0
    runs = np.stack([gauss_markov(generator(s, "gm"), 400, std, tau, dt) for s in range(1500)])
    assert np.std(runs[:, 0]) == pytest.approx(std, rel=0.06)
    assert np.std(runs[:, -1]) == pytest.approx(std, rel=0.06)
    for lag in (10, 40, 80):
        correlation = np.mean(runs[:, :-lag] * runs[:, lag:]) / std**2
        assert correlation == pytest.approx(math.exp(-lag * dt / tau), abs=0.03)


@pytest.mark.parametrize("scale", [3.0, 40.0, 500.0])
def test_smooth_noise_has_unit_variance_and_is_smooth(scale: float) -> None:
    noise = smooth_noise(generator(3, "smooth"), round(3000 * scale), scale)
    assert np.std(noise) == pytest.approx(1.0, rel=0.08)
    # White noise through a Gaussian kernel has slope variance 1/(2 scale²).
    assert np.std(np.diff(noise)) == pytest.approx(1.0 / (math.sqrt(2.0) * scale), rel=0.1)


def test_generators_are_independent_by_purpose_and_equal_by_seed() -> None:
    a, b = generator(5, "gyro_x/white"), generator(5, "gyro_y/white")
    x, y = a.standard_normal(20_000), b.standard_normal(20_000)
    assert abs(float(np.corrcoef(x, y)[0, 1])) < 0.03
    assert np.array_equal(x, generator(5, "gyro_x/white").standard_normal(20_000))
    assert not np.array_equal(x, generator(6, "gyro_x/white").standard_normal(20_000))
