"""Outages with few satellites from recipe to report: the same outages for every number."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.experiment import run_recipe
from navlearn.experiment.methods import build_methods
from navlearn.experiment.sweep import SweepResult, run_sweep
from navlearn.experiment.sweep_drives import make_drive
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import save_log
from navlearn.logs.reading import read_log
from navlearn.outages.known_log import known_log
from navlearn.outages.placement import place_outages
from navlearn.outages.schedule import Outage
from navlearn.recipe.strict import parse
from navlearn.recipe.sweep import SweepRecipe

# The filter of a drive of seven minutes has seen too little for its warnings to count.
pytestmark = pytest.mark.filterwarnings("ignore:filter. .*NIS:UserWarning")

FIGURES = ["max_horizontal_error_m", "rms_horizontal_error_m", "final_azimuth_error_deg"]


def sweep_of(drives: dict[str, Any] | None = None, **entries: Any) -> SweepRecipe:
    simulated = {
        "type": "simulated", "profile": "town", "grades": ["mems_x"], "drives": 1,
        "first_seed": 11, "duration_s": 420.0, "sky": "open_sky",
    }  # fmt: skip
    content: dict[str, Any] = {
        "name": "few",
        "question": "Does it run?",
        "sweep": {**(drives or simulated), "durations_s": [20.0], "satellites": [3, 1, 0]},
        "methods": ["ekf", "tc_ekf"],
        "outages": {"count": 2, "warm_up_s": 250.0, "min_gap_s": 5.0, "good_before_s": 5.0},
        "metric": "rms_horizontal_error_m",
        **entries,
    }
    return parse(SweepRecipe, content, file="test")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> SweepResult:
    return run_sweep(sweep_of(), tmp_path_factory.mktemp("partial") / "run", progress=False)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log, truth = make_drive(sweep_of(), "mems_x", 11)
    return save_log(log, tmp_path_factory.mktemp("drives") / log.metadata.name, truth=truth)


def of(result: SweepResult, method: str, satellites: int) -> pd.DataFrame:
    table = result.table
    mine = (table["method"] == method) & (table["satellites"] == satellites)
    return table[mine].reset_index(drop=True)


def test_every_number_has_the_same_outages(done: SweepResult) -> None:
    assert done.failures == ()
    assert len(done.table) == 3 * 2 * 2
    starts = done.table.groupby(["satellites", "method"])["start_s"].apply(tuple)
    assert len(set(starts)) == 1
    told = done.table["satellites_visible"].str.split().map(len)
    assert (told == done.table["satellites"]).all()
    # the highest are nested: who stays alone is among the three
    three, one = (of(done, "tc_ekf", number)["satellites_visible"] for number in (3, 1))
    assert all(name in more.split() for name, more in zip(one, three, strict=True))


def test_a_loosely_coupled_filter_does_not_see_satellites_and_a_tight_one_does(
    done: SweepResult,
) -> None:
    loose = [of(done, "ekf", number)[FIGURES] for number in (3, 1, 0)]
    pd.testing.assert_frame_equal(loose[0], loose[1], check_exact=True)
    pd.testing.assert_frame_equal(loose[0], loose[2], check_exact=True)
    tight = {number: of(done, "tc_ekf", number)["rms_horizontal_error_m"] for number in (3, 1, 0)}
    assert (tight[3] != tight[0]).all()
    assert (tight[1] != tight[0]).all()
    # three good satellites under an open sky leave little of the drift
    assert tight[3].mean() < tight[0].mean()


@pytest.mark.parametrize("satellites", [3, 0])
def test_a_number_alone_gives_the_same_figures(
    done: SweepResult, drive: Path, tmp_path: Path, satellites: int
) -> None:
    # In the sweep the methods have already been through the same outages with other satellites.
    recipe = sweep_of().for_drive("any", 20.0, "mems_x", satellites)
    source = recipe.log.model_copy(update={"path": drive})
    alone = run_recipe(
        recipe.model_copy(update={"log": source}), tmp_path / "run", progress=False
    ).table
    for name in ("ekf", "tc_ekf"):
        swept = of(done, name, satellites)
        single = alone[alone["method"] == name].reset_index(drop=True)
        assert swept["satellites_visible"].tolist() == single["satellites_visible"].tolist()
        np.testing.assert_allclose(swept[FIGURES], single[FIGURES], rtol=1e-4, atol=1e-4)
    assert (tmp_path / "run" / "sky.png").exists() == (satellites > 0)


def poisoned(log: DriveLog, outage: Outage, *, through: bool = False) -> DriveLog:
    """Return the log with absurd ranges where a method must not see any, or where it does."""
    ranges, fixes = log.ranges.copy(), log.fixes.copy()
    stays = ranges["satellite"].isin(outage.satellites_visible)
    later, inside = ranges["t"] >= outage.start, ranges["t"] <= outage.end
    wrong = later & inside & stays if through else later & ~(inside & stays)
    ranges.loc[wrong, ["pseudorange", "range_rate"]] += 3e4
    ranges.loc[wrong, ["sat_x", "sat_y", "sat_z"]] *= -1.0
    fixes.loc[fixes["t"] >= outage.start, ["lat", "lon"]] = 0.1
    reference = log.reference.assign(lat=-0.3, lon=2.0)
    return replace(log, ranges=ranges, fixes=fixes, reference=reference)


def test_a_tight_filter_sees_nothing_but_the_satellites_that_stay(drive: Path) -> None:
    log = read_log(drive)
    recipe = sweep_of().for_drive("any", 20.0, "mems_x", 2)
    known = place_outages(recipe.outages.protocol(), log).outages[0]

    def solved(seen: DriveLog, outage: Outage) -> pd.DataFrame:
        method = build_methods(recipe)["tc_ekf"]
        return method.predict(known_log(seen, outage), outage).table

    clean = solved(log, known)
    pd.testing.assert_frame_equal(solved(poisoned(log, known), known), clean, check_exact=True)
    # The filter does use those that stay: without them, and with wrong ones, it is elsewhere.
    alone = solved(log, replace(known, satellites_visible=()))
    assert (alone["lat"].iloc[-1], alone["lon"].iloc[-1]) != tuple(clean.iloc[-1][["lat", "lon"]])
    assert not solved(poisoned(log, known, through=True), known).equals(clean)


def test_one_recorded_drive_is_judged_by_outage(drive: Path, tmp_path: Path) -> None:
    recipe = sweep_of({"type": "recorded", "logs": [{"path": str(drive)}]})
    found = run_sweep(recipe, tmp_path / "run", progress=False)
    report = (found.folder / "report.md").read_text(encoding="utf-8")
    assert "> 1 recorded drive." in report
    assert "a paired bootstrap drawn by outage" in report
    assert "### recorded, 20 s, 1 satellite\n" in report
    assert "in at least 90 % of the receptions through it; scored are the outages" in report
    assert "the same ones for every number: 2 of 20 s in recorded\n" in report
    by_number = pd.read_csv(found.folder / "satellites.csv")
    assert set(by_number["drawn_by"]) == {"outage"}
    assert by_number["satellites"].tolist()[::4] == [3, 1, 0]


def test_evaluate_leaves_the_satellites_that_it_is_told(drive: Path, tmp_path: Path) -> None:
    options = ["--outages", "1x20", "--warm-up", "250", "--methods", "tc_ekf", "--quiet"]
    rules = ["--satellites", "2", "--visible", "worst_geometry"]
    out = tmp_path / "run"
    result = CliRunner().invoke(app, ["evaluate", str(drive), *options, *rules, "--out", str(out)])
    assert result.exit_code == 0, result.output
    table = pd.read_csv(out / "outages.csv")
    assert table["satellites"].tolist() == [2]
    assert "(`worst_geometry`)" in (out / "report.md").read_text(encoding="utf-8")
