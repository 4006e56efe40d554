"""Errors of every state over whole drives: known offsets come back, and intervals tell drives."""

import math

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, ShapeError
from navlearn.outages.state_errors import (
    STATES,
    horizontal_figures,
    judged_together,
    state_errors,
    state_rmse,
)
from navlearn.outages.state_tables import gain_table, horizontal_table, rmse_table, state_report

LAT = math.radians(45.0)
# Radii of WGS84 at 45° and on the ellipsoid, from tables.
MERIDIAN, PARALLEL = 6367381.8, 4517590.9


def reference(seconds: float = 200.0, rate: float = 5.0) -> pd.DataFrame:
    """A car that drives circles, its azimuth growing past 180° and 360°."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    azimuth = 0.1 * t
    return pd.DataFrame(
        {
            "t": t,
            "lat": LAT + 100.0 * np.sin(0.1 * t) / MERIDIAN,
            "lon": 100.0 * (1.0 - np.cos(0.1 * t)) / PARALLEL,
            "height": 50.0 + 0.0 * t,
            "v_e": 10.0 * np.sin(azimuth),
            "v_n": 10.0 * np.cos(azimuth),
            "v_u": 0.0 * t,
            "azimuth": np.remainder(azimuth, 2.0 * np.pi),
        }
    )


def off_by(table: pd.DataFrame, **offsets: float) -> pd.DataFrame:
    return table.assign(**{name: table[name] + value for name, value in offsets.items()})


def test_offsets_of_every_state_come_back_in_its_unit() -> None:
    truth = reference()
    solution = off_by(
        truth,
        lat=3.0 / (MERIDIAN + 50.0),
        lon=-4.0 / (PARALLEL + 50.0 * math.cos(LAT)),
        height=2.0,
        v_e=0.1,
        v_n=-0.2,
        v_u=0.3,
        azimuth=math.radians(5.0),
    )
    errors = state_errors(solution, truth)
    assert list(errors.columns) == ["t", *STATES]
    assert len(errors) == len(truth)
    expected = [5.0, 0.1, -0.2, 0.3, 3.0, -4.0, 2.0]
    for state, value in zip(STATES, expected, strict=True):
        np.testing.assert_allclose(errors[state], value, rtol=2e-5, err_msg=state)


def test_a_solution_that_wraps_elsewhere_is_not_off_by_a_turn() -> None:
    truth = reference()
    turned = np.remainder(truth["azimuth"] + np.pi, 2.0 * np.pi) - np.pi
    dense = truth.assign(azimuth=turned)[::2]  # judged between its samples, too
    errors = state_errors(dense, truth)
    assert errors["azimuth"].abs().max() < 1e-6


def test_velocities_are_judged_where_they_hold() -> None:
    truth = reference(rate=10.0)
    late = truth.assign(t=truth["t"] + 0.05, t_velocity=truth["t"])
    errors = state_errors(late, truth)
    assert errors["east velocity"].abs().max() < 0.01 * 10.0 * 0.1**2
    naive = state_errors(late.drop(columns="t_velocity"), truth)
    assert naive["east velocity"].abs().max() > 0.04


def test_sparse_solutions_are_judged_near_their_samples_alone() -> None:
    truth = reference()
    fixes = truth[["t", "lat", "lon", "height"]][::5]
    errors = state_errors(fixes, truth)
    assert errors["t"].tolist() == fixes["t"].tolist()
    assert errors["latitude"].abs().max() < 1e-6
    assert errors["azimuth"].isna().all()
    with pytest.raises(ShapeError, match="1 positions"):
        state_errors(fixes[:1], truth)


def test_all_are_judged_at_the_same_times_after_settling() -> None:
    truth = reference()
    early, late = state_errors(truth, truth), state_errors(truth[truth["t"] >= 30.0], truth)
    found = judged_together({"a": early, "b": late[late["t"] != 100.0]}, settle=20.0)
    times = found.groupby("solution")["t"].apply(list)
    assert times["a"] == times["b"]
    assert times["a"][0] == 50.0
    assert 100.0 not in times["a"]


def drives(sizes: list[float], better: float) -> pd.DataFrame:
    parts = []
    for k, size in enumerate(sizes):
        for name, factor in (("ekf", 1.0), ("ukf", better)):
            columns = dict.fromkeys(STATES, np.full(40, size * factor))
            one = pd.DataFrame({"t": np.arange(40.0), **columns})
            parts.append(one.assign(solution=name, drive=f"drive {k}"))
    return pd.concat(parts, ignore_index=True)


def test_rms_and_gain_are_over_all_times_of_all_drives() -> None:
    sizes = [1.0, 2.0, 3.0, 4.0]
    found = state_rmse(drives(sizes, 0.5), "ekf").set_index(["state", "solution"])
    root = math.sqrt(np.mean(np.square(sizes)))
    row = found.loc[("azimuth", "ekf")]
    assert row["rmse"] == pytest.approx(root)
    assert row["low"] < root < row["high"]
    # every drive gains the same, so the gain is certain though the errors are not
    other = found.loc[("altitude", "ukf")]
    assert other["rmse"] == pytest.approx(0.5 * root)
    assert other["gain_percent"] == pytest.approx(50.0)
    assert other["gain_low"] == pytest.approx(50.0)
    assert other["gain_high"] == pytest.approx(50.0)
    assert (row["drives"], row["times"]) == (4, 160)
    with pytest.raises(ConfigError, match="not among the solutions: ekf, ukf"):
        state_rmse(drives(sizes, 0.5), "rts")


def test_one_drive_has_no_interval() -> None:
    found = state_rmse(drives([2.0], 0.5), "ekf")
    assert found["rmse"].unique().tolist() == [2.0, 1.0]
    assert found[["low", "high", "gain_low", "gain_high"]].isna().all(axis=None)


def test_tables_show_states_down_and_solutions_across() -> None:
    errors = drives([1.0, 3.0], 0.5)
    errors.loc[:, "up velocity"] = np.nan
    found = state_rmse(errors, "ekf")
    lines = rmse_table(found).splitlines()
    assert lines[0] == "| RMS error | unit | ekf | ukf |"
    assert lines[2].startswith("| azimuth | ° | 2.24 (")
    assert "| up velocity | m/s | – | – |" in lines
    assert "| azimuth | % | 0.0 (0.0 to 0.0) | +50.0 (+50.0 to +50.0) |" in gain_table(found)
    off = horizontal_figures(errors)
    assert off.loc["ekf", "largest"] == pytest.approx(3.0 * math.sqrt(2.0))
    assert off.loc["ukf", "median"] == pytest.approx(math.sqrt(2.0))
    assert "| largest | m | 4.24 | 2.12 |" in horizontal_table(off)
    said = state_report(errors, "ekf")
    assert said.startswith("2 drives, 80 times of the reference")
    assert "smaller than that of `ekf`" in said
