"""Methods of a full IMU: they run beside each other, and none knows what it must not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.experiment import run_recipe
from navlearn.experiment.drive import open_log, prepare_drive
from navlearn.experiment.ins_filter_runs import VARIANTS, ins_filter_options, stated_start
from navlearn.experiment.methods import build_methods
from navlearn.experiment.observability import without_outages
from navlearn.experiment.run import check_recipe
from navlearn.experiment.sweep import run_sweep
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Replay, replay
from navlearn.recipe import Recipe, load_recipe
from navlearn.recipe.ingredients import INGREDIENTS
from navlearn.recipe.sweep import load_sweep

MakeRecipe = Callable[..., Recipe]
IMU = {"sensors": "imu"}
WITHOUT_INGREDIENTS = tuple(name for name in VARIANTS if name not in INGREDIENTS)
LEARNS_NOTHING = ("dead_reckoning", *WITHOUT_INGREDIENTS, "rts")

# Filters without bias states and open loops are meant to be wrong, and say so.
pytestmark = pytest.mark.filterwarnings("ignore:filter. :UserWarning")

SCENARIO = """
name: draws
question: Does it run?
sweep: {type: scenario, drives: 2, first_seed: 11, durations_s: [3]}
methods: [dead_reckoning, ins_ekf_open_loop, ins_ekf]
mechanization: {sensors: imu}
ins_filter: {odometer: false, nonholonomic: false}
outages: {count: 1, warm_up_s: 40, warm_up_moving_s: 30, good_before_s: 2, min_gap_s: 5}
"""


@pytest.fixture(scope="module")
def recipe(make_recipe: MakeRecipe) -> Recipe:
    """Nothing is learned, so little need lie before the outages."""
    made = make_recipe(
        methods=LEARNS_NOTHING, mechanization={**IMU, "imu_rate_hz": 10.0}, observability=True
    )
    early = {"warm_up_s": 60.0, "warm_up_moving_s": 20.0, "times_s": (100.0,), "count": 1}
    outages = made.outages.model_copy(update=early)
    log = made.log.model_copy(update={"between_s": (0.0, 250.0)})
    return made.model_copy(update={"outages": outages, "log": log})


def test_a_run_tells_how_they_compare_and_what_was_observed(recipe: Recipe, tmp_path: Path) -> None:
    found = run_recipe(recipe, tmp_path / "run", progress=False)
    table = found.table.set_index("method")["max_horizontal_error_m"]
    assert table.index.unique().tolist() == list(LEARNS_NOTHING)
    assert (table > 0.0).all()
    mean = table.groupby(level=0).mean()
    assert mean["ins_ekf"] < mean["ins_ekf_plain"]
    assert mean["rts"] < mean["ins_ekf_plain"]
    report = (found.folder / "report.md").read_text(encoding="utf-8")
    assert "Against **ins_ekf**" in report
    assert "## Degree of observability" in report
    for name in ("observability.csv", "observability_states.png"):
        assert (found.folder / name).stat().st_size > 0, name
    with np.load(next((found.folder / "solutions").glob("ins_ekf-*.npz"))) as solution:
        assert {"c_pitch", "c_roll", "c_v_u", "c_std_e", "c_cov_en"} <= set(solution.files)
    assert load_recipe(found.folder / "recipe.yaml") == recipe


def spoilt(log: DriveLog, rows: "pd.Series[bool]") -> DriveLog:
    """The log with some fixes on another continent, at the speed of sound."""
    absurd = log.fixes.assign(lat=-0.3, lon=2.0, v_e=340.0, v_n=-340.0)
    return replace(log, fixes=log.fixes.where(~rows, absurd))


def moved(clean: Replay, again: Replay) -> set[str]:
    """Methods whose solution is another one, or is there no more."""
    return {
        name
        for name, number in clean.solutions
        if (name, number) not in again.solutions
        or not again.solutions[name, number].table.equals(clean.solutions[name, number].table)
    }


def test_fixes_inside_an_outage_move_nothing_and_those_before_it_all(recipe: Recipe) -> None:
    ungated = recipe.model_copy(update={"ins_filter": {"gate": {"probability": 1.0}}})
    drive = prepare_drive(ungated)
    outage, t = drive.placement.outages[0], drive.log.fixes["t"]

    def replayed(rows: "pd.Series[bool]") -> Replay:
        log = spoilt(drive.log, rows)
        return replay(log, (outage,), build_methods(ungated), progress=False)

    clean = replayed(t < 0.0)
    assert {name for name, _ in clean.solutions} == set(LEARNS_NOTHING)
    inside = t.between(outage.start, outage.end, inclusive="left")
    before = t.between(outage.start - 3.0, outage.start, inclusive="left")
    after = t >= outage.end + 1.0
    assert all(rows.any() for rows in (inside, before, after))
    assert moved(clean, replayed(inside)) == set()
    assert moved(clean, replayed(before)) == set(LEARNS_NOTHING)
    assert moved(clean, replayed(after)) == {"rts"}


def test_variants_change_the_recipe_s_filter_and_nothing_else(recipe: Recipe) -> None:
    given = recipe.model_copy(update={"ins_filter": {"states": 21, "lever_arm": (0.1, 0.2, 0.3)}})
    log = open_log(recipe)
    honest = ins_filter_options(given, log=log)
    assert (honest.states, honest.lever_arm) == (21, (0.1, 0.2, 0.3))
    assert ins_filter_options(given, "ins_ekf_open_loop", log) == replace(honest, feedback="open")
    blind = replace(log, fixes=log.fixes.drop(columns="v_u"))
    assert not ins_filter_options(given, log=blind).vertical_velocity


def test_outages_are_taken_out_of_a_log_and_nothing_more(recipe: Recipe) -> None:
    drive = prepare_drive(recipe)
    left = without_outages(drive.log, drive.placement.outages).fixes["t"]
    gone = drive.log.fixes["t"][~drive.log.fixes["t"].isin(left)]
    outages = drive.placement.outages
    assert all(any(o.start <= t <= o.end for o in outages) for t in gone)
    assert not any(o.start <= t <= o.end for o in outages for t in left)


def test_a_coast_that_is_never_fed_back_teaches_nothing(make_recipe: MakeRecipe) -> None:
    open_loop = make_recipe(
        methods=("ins_ekf+anarx",), mechanization=IMU, ins_filter={"feedback": "open"}
    )
    with pytest.raises(ConfigError, match=r"leave ins_filter\.feedback closed"):
        check_recipe(open_loop)


def test_a_paper_s_scenario_is_swept_over_draws_of_its_noise(tmp_path: Path) -> None:
    path = tmp_path / "draws.yaml"
    path.write_text(SCENARIO, encoding="utf-8")
    found = run_sweep(load_sweep(path), tmp_path / "run", progress=False)
    assert sorted(found.table["drive"].unique()) == [
        "jaradat2017_jaradat2017_11",
        "jaradat2017_jaradat2017_12",
    ]
    mean = found.table.groupby("method")["max_horizontal_error_m"].mean()
    # Two metres of white noise at 5 Hz leave the filter some decimetres; the INS runs away.
    assert mean["ins_ekf"] < 5.0 < mean["dead_reckoning"]
    report = (found.folder / "report.md").read_text(encoding="utf-8")
    assert "the scenario of [Jaradat2017] §IV, 2 draws, seeds 11 to 12" in report


def test_a_log_that_states_its_start_is_not_aligned(make_recipe: MakeRecipe) -> None:
    recipe = make_recipe(methods=("ins_ekf",), mechanization=IMU)
    assert stated_start(open_log(recipe)) is None
    scenario = recipe.model_copy(
        update={
            "log": recipe.log.model_validate({"simulated": {"profile": "jaradat2017", "seed": 11}})
        }
    )
    found = stated_start(open_log(scenario))
    assert found is not None
    assert found.sample == -1
    assert found.method == "stated"


def test_a_gyro_and_an_odometer_have_their_observability_too(
    make_recipe: MakeRecipe, tmp_path: Path
) -> None:
    recipe = make_recipe(methods=("ekf",), observability=True)
    found = run_recipe(recipe, tmp_path / "run", progress=False)
    report = (found.folder / "report.md").read_text(encoding="utf-8")
    assert "Of `ekf` on short, all outages taken out of one run" in report
    assert "| gyro bias |" in report
