"""Runs that go on from earlier ones: the same as whole runs, and only where the past is."""

from typing import Any

import pytest
import torch

from navlearn.experiment.baselines import FilterRuns, filter_options
from navlearn.experiment.drive import timeline_of
from navlearn.experiment.filter_runs import MadeRun, last_block_in_common, made_run
from navlearn.fusion.history import FilterHistory
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import simulate_drive
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe, recipe_for

OUTAGES = (Outage(300.0, 40.0), Outage(345.5, 30.0), Outage(480.0, 60.0), Outage(600.2, 45.0))
FILTERS: dict[str, dict[str, Any]] = {
    "default": {},
    "any odometer": {"speed_terms": ["scale", "delay", "offset"]},
    "decaying bias": {"correlation_time": 200.0},
    "plain": {"model": "bias_free"},
    "unscented": {"unscented": {}},
    "unscented, with integrity": {
        "unscented": {"alpha": 0.5},
        "gate": {"prediction_limit": 9.0, "motion_limit": 3.0, "robust": "huber"},
    },
}


@pytest.fixture(scope="module")
def log() -> DriveLog:
    drive = simulate_drive(
        profile="town", grade="mems_l", duration=680.0, seed=11, imu_rate_hz=10.0, name="grows"
    )
    return drive.log


def recipe_of(filter: dict[str, Any]) -> Recipe:
    return recipe_for("nowhere", methods=("ekf",), filter=filter)


def assert_alike(one: FilterHistory, other: FilterHistory, slack: float = 1.0) -> None:
    """What the fast form's passes leave; more where its gate and noise do not fit the drive."""
    for name in ("end", "fix", "verdict", "resets"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    for name, tolerance in {"lat": 1e-13, "lon": 1e-13, "azimuth": 1e-8, "v_e": 1e-7}.items():
        torch.testing.assert_close(
            getattr(one.trajectory, name),
            getattr(other.trajectory, name),
            rtol=0,
            atol=slack * tolerance,
        )
    for name in ("covariance", "sensor", "anchor", "refused"):
        for belief in ("belief", "prior"):
            ours, theirs = (getattr(getattr(run, belief), name) for run in (one, other))
            torch.testing.assert_close(ours, theirs, rtol=slack * 1e-6, atol=slack * 1e-9)
    torch.testing.assert_close(
        one.nis, other.nis, rtol=slack * 1e-4, atol=slack * 1e-6, equal_nan=True
    )


@pytest.mark.parametrize("filter", list(FILTERS.values()), ids=list(FILTERS))
@pytest.mark.filterwarnings("ignore:filter. .*NIS:UserWarning")
def test_a_run_that_goes_on_equals_the_whole_run(log: DriveLog, filter: dict[str, Any]) -> None:
    recipe = recipe_of(filter)
    growing = FilterRuns(recipe, growing=True)
    for outage in OUTAGES:
        known = known_log(log, outage)
        _, _, run = growing.run(known)
        timeline, _, whole = FilterRuns(recipe).run(known)
        assert run.first == whole.first
        # passes of sigma points leave a hundredth of a hundredth of a covariance
        slack = 100.0 if "unscented" in filter or filter.get("model") == "bias_free" else 1.0
        assert_alike(run.history, whole.history, slack)
        for ours, theirs in zip(run.samples, whole.samples, strict=True):
            assert torch.equal(ours, theirs)
    exact = Navigator(NavigatorOptions(filter=filter_options(recipe, log=log), method="exact"))
    last = exact.run(timeline.samples, timeline.fixes, timeline.timing)
    torch.testing.assert_close(
        run.history.trajectory.lat, last.history.trajectory.lat, rtol=0, atol=1e-12
    )


def made(log: DriveLog, recipe: Recipe, earlier: MadeRun | None = None) -> MadeRun:
    navigator = Navigator(NavigatorOptions(filter=filter_options(recipe, log=log)))
    return made_run(navigator, timeline_of(log, recipe), earlier)


def test_it_goes_on_from_the_last_fix_in_common(log: DriveLog) -> None:
    recipe = recipe_of({})
    early, late = (known_log(log, outage) for outage in (OUTAGES[0], OUTAGES[2]))
    first = made(early, recipe)
    timeline = timeline_of(late, recipe)
    block = last_block_in_common(first, timeline)
    assert block is not None
    when = float(timeline.t[first.run.first + int(first.run.history.end[block])])
    assert 298.5 < when <= 300.0
    # backwards, too: what an earlier outage hides must not be gone on from
    second = made(late, recipe)
    back = last_block_in_common(second, timeline_of(early, recipe))
    assert back is not None
    assert float(second.timeline.t[second.run.first + int(second.run.history.end[back])]) <= 300.0


def test_nothing_is_gone_on_from_after_a_difference(log: DriveLog) -> None:
    recipe = recipe_of({})
    first = made(known_log(log, OUTAGES[0]), recipe)
    known = known_log(log, OUTAGES[1])

    def time_of(changed: DriveLog) -> float | None:
        timeline = timeline_of(changed, recipe)
        block = last_block_in_common(first, timeline)
        if block is None:
            return None
        return float(timeline.t[first.run.first + int(first.run.history.end[block])])

    fixes = known.fixes.copy()
    fixes.loc[fixes["t"].between(199.5, 200.5), "v_e"] += 1e-9
    assert time_of(known.with_tables({"fixes": fixes})) == pytest.approx(199.0, abs=0.6)
    fewer = known.fixes[~known.fixes["t"].between(199.5, 200.5)]
    assert time_of(known.with_tables({"fixes": fewer})) == pytest.approx(199.0, abs=0.6)
    imu = known.imu.copy()
    imu.loc[imu["t"].between(250.04, 250.06) | (imu.index == 2500), "gyro_z"] += 1e-9
    late = time_of(known.with_tables({"imu": imu}))
    assert late is not None
    assert 248.5 < late <= 250.1
    imu["gyro_z"] += 1e-9
    assert time_of(known.with_tables({"imu": imu})) is None
    changed = known.with_tables({"fixes": fixes})
    assert_alike(made(changed, recipe, first).run.history, made(changed, recipe).run.history)


def test_open_loops_and_other_forms_start_anew(log: DriveLog) -> None:
    timeline = timeline_of(known_log(log, OUTAGES[1]), recipe_of({}))
    first = made(known_log(log, OUTAGES[0]), recipe_of({"feedback": "open"}))
    assert last_block_in_common(first, timeline) is None
