"""The bootstrap by drive and the share of the oracle's gain: against loops, scipy and truth."""

import math
import time

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from navlearn.outages.bootstrap import bootstrap_interval, resampled_sums, tail_probability
from navlearn.outages.oracle_share import OracleShare, share_of_columns, share_of_oracle
from navlearn.outages.statistics import compare_columns, error_table, verdict_of

METRIC = "max_horizontal_error_m"


def table(errors: dict[str, np.ndarray], drives: int) -> pd.DataFrame:
    """Rows of outages whose errors are given per method, shape (drives, outages)."""
    return pd.DataFrame(
        [
            {"drive": f"d{d:02d}", "outage": k, "method": name, METRIC: value}
            for name, values in errors.items()
            for d, row in enumerate(values.reshape(drives, -1))
            for k, value in enumerate(row)
        ]
    )


def drawn(rng: np.random.Generator, drives: int = 20, outages: int = 10) -> dict[str, np.ndarray]:
    """Skewed errors, alike within a drive; the method closes most of the gap."""
    drive = np.exp(rng.normal(0.0, 0.5, (drives, 1)))
    base = drive * np.exp(rng.normal(2.0, 0.7, (drives, outages)))
    factor = np.exp(rng.normal(-0.02, 0.2, (drives, 1)) + rng.normal(-0.08, 0.4, base.shape))
    return {
        "ekf": base,
        "net": base * 0.7 * factor,
        "oracle": base * 0.6 * np.exp(rng.normal(-0.02, 0.2, base.shape)),
    }


def test_sums_of_draws_are_those_of_a_loop() -> None:
    rng = np.random.default_rng(0)
    values, units = rng.gamma(2.0, size=(12, 3)), np.array(list("aabbbcddcaab"))
    fast = resampled_sums(values, units, resamples=40, seed=9)
    picks = np.random.default_rng(9).integers(4, size=(40, 4))
    for draw, pick in enumerate(picks):
        total = np.zeros(3)
        for unit in np.array(list("abcd"))[pick]:
            total += values[units == unit].sum(axis=0)
        np.testing.assert_allclose(fast[draw], total, rtol=1e-12)


def test_draws_that_are_shared_cannot_be_changed() -> None:
    first = resampled_sums(np.ones((5, 1)), np.arange(5), resamples=10)
    first *= 0.0
    assert (resampled_sums(np.ones((5, 1)), np.arange(5), resamples=10) == 5.0).all()


def test_share_is_the_part_of_the_gap_that_is_closed() -> None:
    base = np.linspace(5.0, 15.0, 8)
    rows = table({"ekf": base, "net": 0.8 * base, "oracle": 0.6 * base}, drives=8)
    found = share_of_oracle(rows, "net", metric=METRIC)
    assert found.share_percent == pytest.approx(50.0)
    assert (found.low_percent, found.high_percent) == (pytest.approx(50.0), pytest.approx(50.0))
    assert (found.outages, found.unknown_because) == (8, "")
    worse = table({"ekf": base, "net": 1.4 * base, "oracle": 0.6 * base}, drives=8)
    assert share_of_oracle(worse, "net", metric=METRIC).share_percent == pytest.approx(-100.0)


def test_interval_of_the_share_agrees_with_scipy() -> None:
    errors = drawn(np.random.default_rng(3), drives=12)
    found = share_of_oracle(table(errors, 12), "net", metric=METRIC, resamples=40_000)
    sums = [errors[name].sum(axis=1) for name in ("ekf", "net", "oracle")]

    def share(base: np.ndarray, net: np.ndarray, oracle: np.ndarray, axis: int = -1) -> np.ndarray:
        gained = base.mean(axis=axis) - net.mean(axis=axis)
        return 100.0 * gained / (base.mean(axis=axis) - oracle.mean(axis=axis))

    reference = stats.bootstrap(
        sums,
        share,
        paired=True,
        vectorized=True,
        method="percentile",
        n_resamples=40_000,
        confidence_level=1.0 - 2.0 * tail_probability(12),
        rng=np.random.default_rng(1),
    ).confidence_interval
    assert found.share_percent == pytest.approx(float(share(*sums)))
    assert found.low_percent == pytest.approx(reference.low, abs=0.6)
    assert found.high_percent == pytest.approx(reference.high, abs=0.6)


def test_failures_are_left_out_of_the_share_on_every_side() -> None:
    base = np.linspace(5.0, 15.0, 8)
    net = np.where(np.arange(8) == 3, np.nan, 0.8 * base)
    rows = table({"ekf": base, "net": net, "oracle": 0.6 * base}, drives=8)
    found = share_of_oracle(rows, "net", metric=METRIC)
    assert found.outages == 7
    assert found.share_percent == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("oracle", "why"),
    [
        (1.0, "the oracle's own gain is not clear of zero"),
        (1.3, "the oracle's own gain is not clear of zero"),
        (None, "there is no `oracle` to measure by"),
    ],
)
def test_a_share_of_nothing_is_not_told(oracle: float | None, why: str) -> None:
    base = np.linspace(5.0, 15.0, 8)
    errors = {"ekf": base, "net": 0.8 * base}
    if oracle is not None:
        errors["oracle"] = oracle * base
    found = share_of_oracle(table(errors, 8), "net", metric=METRIC)
    assert found.unknown_because == why
    assert all(map(math.isnan, (found.share_percent, found.low_percent, found.high_percent)))


def test_too_few_drives_tell_no_share() -> None:
    base = np.linspace(5.0, 15.0, 20)
    rows = table({"ekf": base, "net": 0.8 * base, "oracle": 0.6 * base}, drives=5)
    assert "fewer than 6 drives" in share_of_oracle(rows, "net", metric=METRIC).unknown_because


def test_draws_without_a_gain_of_the_oracle_widen_the_interval() -> None:
    """A barely useful oracle: a draw where it loses must not count as a sharp share."""
    base = np.full(40, 10.0)
    oracle = base - np.where(np.arange(40) < 6, 8.0, -0.25)
    net = base - 1.0
    errors = error_table(table({"ekf": base, "net": net, "oracle": oracle}, 40), METRIC)
    found = share_of_columns(errors, "net", resamples=4000)
    assert found.unknown_because == ""
    lost = resampled_sums((base - oracle)[:, None], np.arange(40), resamples=4000)[:, 0]
    assert (lost <= 0.0).any()
    assert found.share_percent == pytest.approx(100.0 * 40.0 / (48.0 - 8.5))
    assert found.low_percent < found.share_percent < found.high_percent


@pytest.mark.parametrize(
    ("low", "high", "units", "failed", "verdict"),
    [
        (0.1, 9.0, 20, 0, "helps"),
        (0.1, 9.0, 20, 1, "no evidence"),
        (0.1, 9.0, 5, 0, "no evidence"),
        (-2.9, 9.0, 20, 0, "harmless"),
        (0.0, 0.0, 20, 0, "harmless"),
        (-2.9, 9.0, 20, 1, "no evidence"),
        (-3.0, 9.0, 20, 0, "no evidence"),
        (-2.0, -0.1, 20, 0, "harms"),
        (-20.0, -0.1, 20, 3, "harms"),
        (-20.0, -0.1, 5, 0, "no evidence"),
        (math.nan, math.nan, 20, 0, "no evidence"),
    ],
)
def test_verdict_of_every_kind_of_interval(
    low: float, high: float, units: int, failed: int, verdict: str
) -> None:
    assert verdict_of(low, high, units, failed) == verdict


def test_twelve_methods_in_eight_cells_take_a_moment() -> None:
    """Far from the seconds allowed, so that a loop over draws would be noticed on any machine."""
    errors = drawn(np.random.default_rng(5))
    names = ["ekf", "oracle", *(f"m{k}" for k in range(10))]
    wide = error_table(
        table({name: errors.get(name, errors["net"] * (1.0 + 0.01 * k))
               for k, name in enumerate(names)}, 20),
        METRIC,
    )  # fmt: skip
    start = time.process_time()
    for _ in range(8):
        for name in names[1:]:
            compare_columns(wide, name, "ekf", resamples=5000)
            share_of_columns(wide, name, "ekf", resamples=5000)
    assert time.process_time() - start < 8.0


@pytest.mark.slow
def test_intervals_by_drive_cover_the_truth_for_twenty_drives() -> None:
    """20 drives of 10 outages, errors skewed and alike within a drive: nominal 95 %."""
    truth = drawn(np.random.default_rng(0), drives=400_000, outages=1)
    base, net, oracle = (truth[name].mean() for name in ("ekf", "net", "oracle"))
    gain, share = 100.0 * (1.0 - net / base), 100.0 * (base - net) / (base - oracle)
    by_drive = by_outage = of_share = 0
    draws = 1500
    units = np.repeat(np.arange(20), 10)
    index = pd.MultiIndex.from_product([range(20), range(10)], names=["drive", "outage"])
    for k in range(draws):
        errors = {name: v.ravel() for name, v in drawn(np.random.default_rng([1, k])).items()}
        low, high = bootstrap_interval(errors["net"], errors["ekf"], units, resamples=2000)
        by_drive += low <= gain <= high
        low, high = bootstrap_interval(errors["net"], errors["ekf"], np.arange(200), resamples=2000)
        by_outage += low <= gain <= high
        found: OracleShare = share_of_columns(pd.DataFrame(errors, index=index), "net", "ekf")
        of_share += found.low_percent <= share <= found.high_percent
    assert 0.92 < by_drive / draws < 0.97
    assert 0.91 < of_share / draws < 0.97
    assert by_outage < by_drive - 0.05 * draws
