"""Faults put into fixes: sizes told back by the drive's own fixes, schedules, other columns."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.logs.clock import without_latency
from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.synthetic import (
    Biases,
    FaultOptions,
    Freezes,
    Ramps,
    Spikes,
    simulate_drive,
    with_faults,
)
from navlearn.logs.synthetic.fault_schedule import planned_faults
from navlearn.logs.synthetic.faults import injected_faults

EARTH = 6378137.0
EVERY = FaultOptions(
    spikes=Spikes(sizes=(5.0, 50.0), per_hour=60.0),
    biases=Biases(per_hour=20.0),
    ramps=Ramps(per_hour=20.0),
    freezes=Freezes(per_hour=20.0),
    seed=3,
)


@pytest.fixture(scope="module")
def log():
    return simulate_drive(grade="ideal", duration=1800.0, seed=11, imu_rate_hz=5.0).log


def metres(log, other):
    """A sphere's metres between the fixes of two logs: another formula than the code's."""
    one, two = log.fixes, other.fixes
    north = (one["lat"] - two["lat"]) * EARTH
    east = (one["lon"] - two["lon"]) * EARTH * np.cos(two["lat"])
    return np.stack([east, north, one["height"] - two["height"]], axis=-1)


def test_nothing_asked_nothing_changed(log):
    made = with_faults(log, FaultOptions())
    pd.testing.assert_frame_equal(made.log.fixes, log.fixes)
    assert made.table.empty
    assert (made.offsets["fault"] == 0).all()


def test_the_record_tells_what_the_fixes_show(log):
    made = with_faults(log, EVERY)
    assert set(made.table["kind"]) == {"spike", "bias", "ramp", "freeze"}
    shown = metres(made.log, log)
    # half a percent is what a sphere errs
    np.testing.assert_allclose(made.offsets[["east", "north", "up"]], shown, rtol=0.008, atol=1e-3)
    still = made.offsets["fault"] == 0
    pd.testing.assert_frame_equal(made.log.fixes[still], log.fixes[still])
    for name in ("imu", "odometer", "reference"):
        pd.testing.assert_frame_equal(made.log.tables()[name], log.tables()[name])
    for row in made.table.itertuples():
        mine = made.offsets[made.offsets["fault"] == row.fault]
        assert len(mine) == row.fixes
        assert mine["t"].iloc[0] == row.t
        assert mine["t"].iloc[-1] - row.t == row.duration
        assert np.hypot(mine["east"], mine["north"]).max() == pytest.approx(
            np.hypot(row.east, row.north)
        )


def test_faults_neither_touch_nor_begin_early(log):
    table = with_faults(log, replace(EVERY, apart=20.0, settle=100.0)).table
    assert table["t"].min() >= 100.0
    end = (table["t"] + table["duration"]).to_numpy()[:-1]
    assert (table["t"].to_numpy()[1:] - end >= 20.0).all()


@pytest.mark.parametrize("size", [2.0, 100.0])
def test_spikes_have_their_size_in_every_direction(log, size):
    dense = FaultOptions(spikes=Spikes(sizes=(size,), per_hour=3600.0), apart=0.0, settle=0.0)
    made = with_faults(log.between(0.0, 500.0), dense)
    assert len(made.table) > 250
    np.testing.assert_allclose(np.hypot(made.table["east"], made.table["north"]), size)
    assert (made.table["duration"] == 0.0).all()
    # uniform directions: both components vanish on average to 1/sqrt(2 n)
    mean = made.table[["east", "north"]].mean() / size
    assert (mean.abs() < 4.0 / np.sqrt(2.0 * len(made.table))).all()


def test_rates_are_those_asked_for(log):
    t = log.fixes["t"].to_numpy()
    hits = [
        len(planned_faults(t, FaultOptions(spikes=Spikes(per_hour=40.0), apart=0.0, seed=s)))
        for s in range(60)
    ]
    expected = 40.0 * (1800.0 - 60.0) / 3600.0
    assert np.mean(hits) == pytest.approx(expected, abs=4.0 * np.sqrt(expected / 60.0))


def test_one_kind_more_changes_no_draw_of_another(log):
    alone = with_faults(log, FaultOptions(spikes=Spikes(per_hour=20.0), seed=5)).table
    both = with_faults(
        log, FaultOptions(spikes=Spikes(per_hour=20.0), freezes=Freezes(), seed=5)
    ).table
    spikes = both[both["kind"] == "spike"]
    assert len(spikes) > 3
    assert set(spikes["east"]) <= set(alone["east"])
    again = with_faults(log, FaultOptions(spikes=Spikes(per_hour=20.0), seed=6)).table
    assert set(again["east"]).isdisjoint(alone["east"])


def test_a_ramp_grows_evenly_and_takes_the_velocity_along(log):
    made = with_faults(log, FaultOptions(ramps=Ramps(sizes=(60.0,), velocity=True), seed=1))
    row = made.table.iloc[0]
    mine = made.offsets["fault"] == 1
    size = np.hypot(made.offsets["east"], made.offsets["north"])[mine].to_numpy()
    np.testing.assert_allclose(size, np.arange(1, 61), rtol=1e-9)
    moved = (made.log.fixes[["v_e", "v_n"]] - log.fixes[["v_e", "v_n"]])[mine]
    np.testing.assert_allclose(np.hypot(moved["v_e"], moved["v_n"]), 1.0)
    assert np.arctan2(row.v_east, row.v_north) == pytest.approx(np.arctan2(row.east, row.north))
    right = with_faults(log, FaultOptions(ramps=Ramps(sizes=(60.0,)), seed=1))
    pd.testing.assert_frame_equal(right.log.fixes[["v_e", "v_n"]], log.fixes[["v_e", "v_n"]])


@pytest.mark.parametrize("velocity", [True, False])
def test_a_freeze_repeats_to_the_last_digit(log, velocity):
    made = with_faults(log, FaultOptions(freezes=Freezes(velocity=velocity), seed=2))
    for row in made.table.itertuples():
        rows = slice(row.first_row, row.first_row + row.fixes)
        part, before = made.log.fixes.iloc[rows], log.fixes.iloc[row.first_row - 1]
        assert (part[["lat", "lon", "height"]] == before[["lat", "lon", "height"]]).all().all()
        own = log.fixes.iloc[rows] if not velocity else before
        assert (part[["v_e", "v_n", "v_u"]] == own[["v_e", "v_n", "v_u"]]).all().all()


def test_an_honest_receiver_tells_of_it_and_others_do_not(log):
    biases = Biases(sizes=(30.0,), vertical=0.5, velocity=2.0)
    silent = with_faults(log, FaultOptions(biases=biases, seed=1))
    honest = with_faults(log, FaultOptions(biases=replace(biases, honest=True), seed=1))
    told = ["std_e", "std_n", "std_u"]
    pd.testing.assert_frame_equal(silent.log.fixes[told], log.fixes[told])
    mine = honest.offsets["fault"] > 0
    expected = np.hypot(log.fixes[told][mine], [30.0, 30.0, 15.0])
    np.testing.assert_allclose(honest.log.fixes[told][mine], expected)
    assert set(honest.table["up"].abs().round(9)) == {15.0}
    moved = (honest.log.fixes[["v_e", "v_n"]] - log.fixes[["v_e", "v_n"]])[mine]
    np.testing.assert_allclose(np.hypot(moved["v_e"], moved["v_n"]), 2.0)


def test_a_log_that_tells_little_is_enough(log):
    bare = replace(log, fixes=log.fixes[["t", "lat", "lon"]])
    made = with_faults(bare, EVERY).log.fixes
    assert list(made.columns) == ["t", "lat", "lon"]
    honest = FaultOptions(spikes=Spikes(honest=True))
    fixes = with_faults(bare, honest).log.fixes
    assert fixes["std_e"].dropna().tolist() == pytest.approx([20.0] * fixes["std_e"].count())


def test_a_fix_without_position_keeps_none(log):
    fixes = log.fixes.copy()
    lost = np.arange(len(fixes)) % 3 == 0
    fixes.loc[lost, ["lat", "lon", "height"]] = np.nan
    made = with_faults(replace(log, fixes=fixes), EVERY)
    assert made.log.fixes.loc[lost, "lat"].isna().all()
    assert (made.offsets["fault"][lost] == 0).all()
    assert made.log.fixes.loc[~lost, "lat"].notna().all()
    assert len(made.table) > 10
    with pytest.raises(LogError, match="no fix has a position"):
        with_faults(replace(log, fixes=log.fixes.iloc[:0]), EVERY)


def test_the_log_itself_tells_of_its_faults_on_its_own_clock(log, tmp_path):
    late = replace(log, metadata=replace(log.metadata, gnss_latency=0.2, latency_removed=False))
    made = with_faults(late, EVERY)
    pd.testing.assert_frame_equal(injected_faults(made.log), made.table)
    shifted = injected_faults(without_latency(made.log))
    np.testing.assert_allclose(shifted["t"], made.table["t"] - 0.2)
    assert injected_faults(log) is None
    save_log(made.log, tmp_path / "drive")
    assert made.log.metadata.name.endswith("_faults_3")
    assert len(load_log(tmp_path / "drive").fixes) == len(log.fixes)


@pytest.mark.parametrize(
    ("kinds", "named"),
    [
        ({"spikes": Spikes(sizes=())}, "faults.spikes.sizes"),
        ({"spikes": Spikes(sizes=(-1.0,))}, "faults.spikes.sizes"),
        ({"biases": Biases(durations=(0.0,))}, "faults.biases.durations"),
        ({"ramps": Ramps(per_hour=-1.0)}, "faults.ramps.per_hour"),
        ({"freezes": Freezes(per_hour=float("nan"))}, "faults.freezes.per_hour"),
        ({"seed": -1}, "faults.seed"),
        ({"apart": float("inf")}, "faults.apart"),
    ],
)
def test_figures_without_meaning_are_named(kinds, named):
    with pytest.raises(ConfigError, match=named):
        FaultOptions(**kinds)


def test_a_log_that_was_cut_does_not_tell_wrong_times_of_its_faults(log):
    faulty = with_faults(log, EVERY).log
    for part in (faulty.between(0.0, 900.0), faulty.between(600.0, 1800.0)):
        with pytest.raises(LogError, match="cut a log first"):
            injected_faults(part)
