"""The smoothed filter as a method for outages."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from navlearn.experiment import run_recipe
from navlearn.experiment.baselines import (
    Believed,
    FilterMethod,
    FilterRuns,
    believed_table,
    filter_options,
)
from navlearn.experiment.rts_method import SmoothedFilter
from navlearn.fusion.measurements import Kind
from navlearn.fusion.smoothing import SmoothingOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.metrics import check_solution, errors_over_time
from navlearn.outages.replay import replay
from navlearn.outages.schedule import Outage
from navlearn.outages.track import track_of
from navlearn.recipe import Recipe

MakeRecipe = Callable[..., Recipe]
OUTAGES = (Outage(200.0, 60.0), Outage(340.0, 60.0))


def test_smoothing_beats_the_filter_and_knows_it(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    recipe = make_recipe(methods=("ekf", "rts"))
    runs = FilterRuns(recipe)
    methods = {"ekf": FilterMethod(runs, "ekf"), "rts": SmoothedFilter(runs)}
    found = replay(short_drive, OUTAGES, methods, progress=False)
    mean = found.rows.groupby("method")["max_horizontal_error_m"].mean()
    assert mean["rts"] < 0.5 * mean["ekf"]
    for number, outage in enumerate(OUTAGES, start=1):
        made = found.solutions["rts", number]
        check_solution(made.table, outage)
        inside = made.table[made.table["t"].between(outage.start + 10.0, outage.end - 10.0)]
        causal = found.solutions["ekf", number].table
        end = causal[causal["t"] <= outage.end].iloc[-1]
        assert inside["std_e"].max() < end["std_e"]
        # surest where fixes are near, least sure between them
        peak = made.table["t"].iloc[int(np.argmax(made.table["std_e"] + made.table["std_n"]))]
        assert outage.start + 10.0 < peak < outage.end - 10.0
        assert made.notes["fixes_after"] in (60, 61, 120, 121)
        assert 1 <= int(str(made.notes["passes"])) <= 10


def test_no_fix_after_the_outage_leaves_the_filters_end(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    """With nothing to see afterwards, smoothing can tell nothing of the outage's end."""
    outage = OUTAGES[0]
    runs = FilterRuns(make_recipe(methods=("ekf", "rts")))
    known = known_log(short_drive, outage)
    causal = FilterMethod(runs, "ekf").predict(known, outage).table.iloc[-1]
    once = SmoothedFilter(runs, SmoothingOptions(passes=1)).predict(known, outage)
    last = once.table.iloc[-1]
    assert once.notes["fixes_after"] == 0
    for name in ("lat", "lon", "azimuth", "std_e", "std_n"):
        assert last[name] == pytest.approx(causal[name], rel=1e-4), name


def test_smoothing_a_whole_drive_makes_a_reference(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    """Of a log without a better instrument: closer to the truth than the filter was."""
    timeline, navigator, run = FilterRuns(make_recipe(methods=("ekf",))).run(short_drive)
    found = navigator.smooth(run, timeline.fixes, timeline.timing)
    t, track = timeline.t[run.first :], track_of(short_drive)
    part = Outage(60.0, 380.0)
    covariance = found.belief.covariance[..., :2, :2]
    rms = []
    for path in (run.history.trajectory, found.trajectory):
        solution = believed_table(t, Believed(path, found.end, covariance), part)
        errors = errors_over_time(solution, track, part)
        rms.append(errors[["horizontal", "azimuth"]].pow(2).mean().pow(0.5))
    # what GNSS is off by for minutes stays in both
    assert rms[1]["horizontal"] < rms[0]["horizontal"]
    assert rms[1]["azimuth"] < 0.8 * rms[0]["azimuth"]


def test_a_stretch_tells_of_the_outage_what_the_whole_drive_does(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    outage = OUTAGES[0]
    runs = FilterRuns(make_recipe(methods=("rts",)))
    log = known_log(short_drive, outage, after=SmoothedFilter.sees_after)
    table = SmoothedFilter(runs).predict(log, outage).table
    timeline, navigator, run = runs.run(log)
    whole = navigator.smooth(run, timeline.fixes, timeline.timing)
    covariance = whole.belief.covariance[..., :2, :2]
    expected = believed_table(
        timeline.t[run.first :], Believed(whole.trajectory, whole.end, covariance), outage
    )
    scales = {"lat": 6.4e6, "lon": 6.4e6, "v_e": 10.0, "v_n": 10.0, "azimuth": 100.0}
    for name, metres in scales.items():
        assert (table[name] - expected[name]).abs().max() * metres < 0.05, name
    for name in ("std_e", "std_n"):
        assert table[name].to_numpy() == pytest.approx(expected[name].to_numpy(), rel=1e-3)


def test_a_hill_in_the_outage_costs_no_fix_after_it(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    """A filter that knows of no hills refuses fixes after an outage that climbed by 40 m."""
    outage = OUTAGES[0]
    climb = 40.0 * ((short_drive.fixes["t"] - outage.start) / outage.duration).clip(0.0, 1.0)
    hilly = replace(
        short_drive, fixes=short_drive.fixes.assign(height=short_drive.fixes["height"] + climb)
    )
    runs = FilterRuns(make_recipe(methods=("rts",)))
    log = known_log(hilly, outage, after=SmoothedFilter.sees_after)
    options = filter_options(runs.recipe, log=log)
    level = replace(options, noise=replace(options.noise, hill_walk=0.1))
    assert int(runs.run(log, level)[2].history.resets[Kind.POSITION]) > 0
    assert int(runs.run(log)[2].history.resets[Kind.POSITION]) == 0
    made = SmoothedFilter(runs).predict(log, outage)
    assert made.notes["gate_reset_after"] is False
    flat = SmoothedFilter(runs).predict(
        known_log(short_drive, outage, after=SmoothedFilter.sees_after), outage
    )
    for name in ("lat", "lon"):
        assert (made.table[name] - flat.table[name]).abs().max() * 6.4e6 < 0.1
    climbed = (made.table["height"] - flat.table["height"]).to_numpy()
    # from one level to the other, as far as the car moved
    assert climbed[[0, -1]] == pytest.approx([0.0, 40.0], abs=4.0)
    assert (np.diff(climbed) > -0.01).all()


def test_a_run_tells_that_smoothing_is_not_for_real_time(
    make_recipe: MakeRecipe, tmp_path: Path
) -> None:
    result = run_recipe(make_recipe(methods=("ekf", "rts")), tmp_path / "run", progress=False)
    report = (result.folder / "report.md").read_text(encoding="utf-8")
    assert "not a real-time method" in report
    assert set(result.table["method"]) == {"ekf", "rts"}
    assert len(list((result.folder / "solutions").glob("rts-*.npz"))) == 2
