import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from navlearn.errors import ConfigError
from navlearn.outages.bootstrap import bootstrap_interval, improvement, tail_probability
from navlearn.outages.method_table import method_table
from navlearn.outages.statistics import averages, compare, verdict_of

METRIC = "max_horizontal_error_m"


def table(drives: int = 1, **methods: list[float]) -> pd.DataFrame:
    """Rows of outages whose errors are given per method, dealt out to the drives in turn."""
    rows = []
    for method, errors in methods.items():
        for k, error in enumerate(errors):
            rows.append(
                {"drive": f"d{k % drives}", "outage": k // drives + 1, "method": method}
                | {METRIC: error}
            )
    return pd.DataFrame(rows)


def test_improvement_is_a_ratio_of_means_not_a_mean_of_ratios() -> None:
    ours, theirs = np.array([1.0, 90.0]), np.array([10.0, 100.0])
    assert improvement(ours, theirs) == pytest.approx(100.0 * (1.0 - 91.0 / 110.0))
    assert math.isnan(improvement(np.zeros(2), np.zeros(2)))


def test_averages_leave_failures_out_and_count_them() -> None:
    found = averages(table(ekf=[1.0, 2.0, math.nan, 3.0, 10.0]), "ekf")
    assert (found.outages, found.failed) == (5, 1)
    assert (found.mean, found.median) == (4.0, 2.5)
    assert found.p90 == pytest.approx(3.0 + 0.7 * 7.0)  # place 0.9 · 3 = 2.7 among four


def test_interval_agrees_with_scipy() -> None:
    rng = np.random.default_rng(0)
    theirs = rng.gamma(4.0, 3.0, 25)
    ours = theirs * rng.uniform(0.5, 1.2, 25)
    low, high = bootstrap_interval(ours, theirs, np.arange(25), resamples=40_000)

    def gain(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
        return 100.0 * (1.0 - a.mean(axis=axis) / b.mean(axis=axis))

    reference = stats.bootstrap(
        (ours, theirs),
        gain,
        paired=True,
        vectorized=True,
        method="percentile",
        n_resamples=40_000,
        confidence_level=1.0 - 2.0 * tail_probability(25),
        rng=np.random.default_rng(1),
    ).confidence_interval
    assert low == pytest.approx(reference.low, abs=0.25)
    assert high == pytest.approx(reference.high, abs=0.25)


def test_expanded_interval_of_a_normal_mean_is_that_of_student() -> None:
    """z(tail) · s_n/√n = t · s/√n, where s_n divides by n and s by n − 1."""
    for n in (5, 10, 50):
        wide = -stats.norm.ppf(tail_probability(n)) * math.sqrt((n - 1) / n)
        assert wide == pytest.approx(stats.t.ppf(0.975, n - 1), rel=1e-12)


def test_interval_is_the_same_for_the_same_seed_only() -> None:
    rng = np.random.default_rng(0)
    a, b, units = rng.gamma(2, size=12), rng.gamma(2, size=12), np.arange(12)
    assert bootstrap_interval(a, b, units, seed=4) == bootstrap_interval(a, b, units, seed=4)
    assert bootstrap_interval(a, b, units, seed=4) != bootstrap_interval(a, b, units, seed=5)


def test_outages_of_a_drive_are_drawn_together() -> None:
    """Ten equal outages per drive tell no more than one: the interval must not shrink."""
    rng = np.random.default_rng(2)
    theirs = rng.gamma(9.0, size=8)
    ours = theirs * rng.uniform(0.6, 1.2, 8)
    one = bootstrap_interval(ours, theirs, np.arange(8))
    ten = bootstrap_interval(
        np.repeat(ours, 10), np.repeat(theirs, 10), np.repeat(np.arange(8), 10)
    )
    assert ten == pytest.approx(one)
    single = bootstrap_interval(np.repeat(ours, 10), np.repeat(theirs, 10), np.arange(80))
    assert single[1] - single[0] < 0.5 * (one[1] - one[0])


def test_counts_of_a_hand_made_case() -> None:
    rows = table(ekf=[10.0] * 8, net=[5.0, 5.0, 5.0, 10.0, 10.9, 11.1, 20.0, math.nan])
    found = compare(rows, "net", "ekf", metric=METRIC)
    assert (found.pairs, found.wins, found.ties) == (7, 3, 1)
    assert found.harm_count == 3  # 11.1, 20.0 and the failure; 10.9 is within 10 %
    assert found.win_rate_percent == pytest.approx(100.0 * 3 / 7)
    assert found.sign_test_p == pytest.approx(1.0)  # three better, three worse
    assert found.improvement_percent == pytest.approx(100.0 * (1.0 - 67.0 / 70.0))
    assert (found.units, found.drawn_by) == (7, "outage")


def test_sign_test_is_the_binomial_tail() -> None:
    rows = table(ekf=[10.0] * 8, net=[5.0] * 7 + [15.0])
    found = compare(rows, "net", "ekf", metric=METRIC)
    assert found.sign_test_p == pytest.approx(2 * (1 + 8) / 2**8)


def test_verdicts() -> None:
    rng = np.random.default_rng(5)
    base = rng.uniform(8.0, 12.0, 12).tolist()
    better = [0.6 * value for value in base]
    mixed = [value * (0.7 if k % 2 else 1.3) for k, value in enumerate(base)]
    rows = table(ekf=base, better=better, mixed=mixed)
    assert compare(rows, "better", "ekf", metric=METRIC).verdict == "helps"
    assert compare(rows, "ekf", "better", metric=METRIC).verdict == "harms"
    assert compare(rows, "mixed", "ekf", metric=METRIC).verdict == "no evidence"
    few = rows[rows["outage"] <= 5]
    assert compare(few, "better", "ekf", metric=METRIC).verdict == "no evidence"
    drives = table(drives=3, ekf=base, better=better)
    found = compare(drives, "better", "ekf", metric=METRIC)
    assert (found.units, found.drawn_by, found.verdict) == (3, "drive", "no evidence")
    assert verdict_of(math.nan, math.nan, 20) == "no evidence"


def test_a_baseline_without_error_gives_no_verdict() -> None:
    found = compare(table(ekf=[0.0] * 8, net=[1.0] * 8), "net", "ekf", metric=METRIC)
    assert math.isnan(found.improvement_percent)
    assert found.verdict == "no evidence"


def test_table_has_a_row_per_method_and_compares_with_what_is_there() -> None:
    rows = table(dead_reckoning=[4.0] * 8, ekf=[2.0] * 8, net=[1.0] * 8)
    found = method_table(rows, resamples=200).set_index("method")
    assert list(found.index) == ["dead_reckoning", "ekf", "net"]
    assert found.loc["net", "improvement_percent_vs_ekf"] == 50.0
    assert found.loc["dead_reckoning", "improvement_percent_vs_ekf"] == -100.0
    assert pd.isna(found.loc["ekf", "verdict_vs_ekf"])
    assert not any("ekf_plain" in name for name in found.columns)


def test_wrong_requests_are_refused() -> None:
    rows = table(ekf=[1.0, 2.0], net=[1.0, 2.0])
    with pytest.raises(ConfigError, match="no method 'ukf'"):
        compare(rows, "ukf", "ekf", metric=METRIC)
    with pytest.raises(ConfigError, match="no column 'speed'"):
        compare(rows, "net", "ekf", metric="speed")
    with pytest.raises(ConfigError, match="has an outage twice"):
        compare(pd.concat([rows, rows]), "net", "ekf", metric=METRIC)


@pytest.mark.slow
def test_interval_covers_the_true_gain_nearly_as_often_as_it_says() -> None:
    """Skewed errors, ten outages: nominal 95 %, plain percentiles reach 87 %."""
    rng = np.random.default_rng(1)
    truth = 100.0 * (1.0 - math.exp(0.125))
    hits = 0
    for seed in range(2000):
        theirs = np.exp(rng.normal(2.0, 0.7, 10))
        ours = theirs * np.exp(rng.normal(0.0, 0.5, 10))
        low, high = bootstrap_interval(ours, theirs, np.arange(10), resamples=1000, seed=seed)
        hits += low <= truth <= high
    assert 0.89 < hits / 2000 < 0.96
