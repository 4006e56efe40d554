import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from navlearn.logs.interval_means import interval_means, longest_gap, typical_period

times = st.lists(st.floats(0.01, 1.0), min_size=2, max_size=12).map(np.cumsum)


def test_means_of_lines_equal_numerical_quadrature():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.2, 0.8, 20))
    values = rng.standard_normal(20)
    edges = np.linspace(t[0] - 0.3, t[-1] + 0.3, 41)
    found = interval_means(t, values, edges)
    for k in range(40):
        inside = t[(t > edges[k]) & (t < edges[k + 1])]
        exact = quad(np.interp, edges[k], edges[k + 1], args=(t, values), points=inside)[0]
        assert found[k] * (edges[k + 1] - edges[k]) == pytest.approx(exact, abs=1e-12)


def test_steps_on_their_own_grid_are_the_samples():
    t = np.arange(1, 200) / 10.0
    values = np.random.default_rng(2).standard_normal(t.size)
    found = interval_means(t, values, np.arange(200) / 10.0, sampling="interval")
    np.testing.assert_allclose(found, values, atol=1e-12)


def test_steps_halved_in_rate_are_means_of_pairs():
    t = np.arange(1, 201) / 100.0
    values = np.random.default_rng(3).standard_normal(t.size)
    found = interval_means(t, values, np.arange(101) / 50.0, sampling="interval")
    np.testing.assert_allclose(found, values.reshape(-1, 2).mean(1), atol=1e-11)


def test_instants_of_a_ramp_lie_half_a_step_before_steps():
    t = np.arange(0, 101) / 10.0
    edges = np.arange(1, 100) / 10.0
    lines = interval_means(t, t, edges)
    steps = interval_means(t, t, edges, sampling="interval")
    np.testing.assert_allclose(steps - lines, 0.05, atol=1e-12)


def test_a_single_sample_is_constant():
    np.testing.assert_allclose(
        interval_means(np.array([3.0]), np.array([7.0]), np.arange(4.0)), 7.0
    )


@given(times, st.integers(1, 30), st.sampled_from(["instant", "interval"]))
def test_distance_is_preserved_on_any_grid(t, count, sampling):
    values = np.cos(7.0 * t) + 2.0
    edges = np.linspace(t[0], t[-1], count + 1)
    if edges[-1] <= edges[0]:
        return
    fine = interval_means(t, values, edges, sampling=sampling) * np.diff(edges)
    whole = interval_means(t, values, edges[[0, -1]], sampling=sampling) * (edges[-1] - edges[0])
    assert fine.sum() == pytest.approx(whole[0], rel=1e-12)
    if sampling == "instant":
        assert whole[0] == pytest.approx(np.trapezoid(values, t), rel=1e-12)


def test_longest_gap_counts_the_ends():
    t = np.array([0.0, 1.0, 2.0, 5.0, 6.0])
    assert longest_gap(t, 0.0, 6.0) == (2.0, 3.0)
    assert longest_gap(t, 0.0, 20.0) == (6.0, 14.0)
    assert longest_gap(t, 2.5, 3.5) == (2.0, 3.0)
    assert longest_gap(t, 0.2, 1.9) == (0.0, 1.0)


def test_typical_period_is_the_median():
    assert typical_period(np.array([0.0, 1.0, 2.0, 9.0])) == 1.0
    assert typical_period(np.array([0.0])) == 0.0
