"""No solution of an outage moves when absurd fixes and references are planted in or after it."""

from collections.abc import Callable
from dataclasses import replace

import pandas as pd
import pytest

from navlearn.experiment.drive import prepare_drive, set_clocks
from navlearn.experiment.methods import build_methods
from navlearn.experiment.rts_method import SmoothedFilter
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Replay, replay
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.recipe.spec import BUILT_IN

MakeRecipe = Callable[..., Recipe]


def absurd(table: pd.DataFrame, since: float) -> pd.DataFrame:
    """Positions on another continent, at the speed of sound, stated to be exact."""
    table = table.copy()
    rows = table["t"] >= since
    values = {"lat": -0.3, "lon": 2.0, "height": 5e3, "v_e": 340.0, "v_n": -340.0, "v_u": 9.0}
    values |= {"std_e": 0.01, "std_n": 0.01, "std_u": 0.01, "std_v": 0.01, "azimuth": 3.0}
    for name, value in values.items():
        if name in table:
            table.loc[rows, name] = value
    return table


def poisoned(log: DriveLog, since: float) -> DriveLog:
    assert log.reference is not None
    return replace(log, fixes=absurd(log.fixes, since), reference=absurd(log.reference, since))


def solved(recipe: Recipe, log: DriveLog, outages: tuple[Outage, ...]) -> Replay:
    """Solutions of methods made anew, clocks set from the log itself."""
    log, _ = set_clocks(log, recipe, outages[0].start)
    return replay(log, outages, build_methods(recipe), progress=False)


@pytest.mark.parametrize("acts_on", ["position", "azimuth_rate"])
def test_no_solution_moves(make_recipe: MakeRecipe, acts_on: str) -> None:
    recipe = make_recipe(acts_on=acts_on)
    drive = prepare_drive(recipe)
    outages = drive.placement.outages
    assert len(outages) == 2
    clean = solved(recipe, drive.log, outages)
    assert all(note.notes.get("used", True) for note in clean.solutions.values())
    for number, outage in enumerate(outages, start=1):
        again = solved(recipe, poisoned(drive.log, outage.start), (outage,))
        for name in recipe.methods:
            mine, other = again.solutions[name, 1], clean.solutions[name, number]
            pd.testing.assert_frame_equal(mine.table, other.table, check_exact=True)
            assert mine.notes == other.notes


def ungated(name: str) -> dict[str, object]:
    """The built-in model of a name without its gate, so that it acts if it can."""
    return {**brief(name), "name": f"{name}_raw", "safeguard": {"gate": False}}


def brief(name: str) -> dict[str, object]:
    """The built-in model of a name; one of a full IMU, which learns many rows, trains briefly."""
    content = BUILT_IN[name].model_dump()
    if content["type"] == "ins_anarx":
        content |= {"name": f"{name}_brief", "max_iterations": 2, "hidden": 2, "window_s": None}
        content |= {"window_s": 100.0} if content["mode"] == "paper" else {}
    return content


def test_no_method_that_learns_sees_the_outage(make_recipe: MakeRecipe) -> None:
    """Every built-in model, whatever it learns from, raw as well as behind its gate.

    Those of range errors have a drive with ranges, and a test, of their own.
    """
    left = [name for name, spec in BUILT_IN.items() if not isinstance(spec, RangeErrorSpec)]
    names = [name for name in left if name != "anarx"]
    raw = [ungated(name) for name in names]
    guarded = [brief(name) for name in names]
    recipe = make_recipe(methods=("tiny",))
    content = recipe.model_dump()
    models = [*content["models"], *guarded, *raw]
    methods = [spec["name"] for spec in models if spec["name"] != "tiny"]
    recipe = Recipe.model_validate({**content, "models": models, "methods": methods})
    drive = prepare_drive(recipe)
    outage = drive.placement.outages[1]
    clean = solved(recipe, drive.log, (outage,))
    again = solved(recipe, poisoned(drive.log, outage.start), (outage,))
    acted = 0
    for name in methods:
        if (name, 1) not in clean.solutions:  # the papers' own filters may diverge, alike
            assert (name, 1) not in again.solutions
            continue
        mine, other = again.solutions[name, 1], clean.solutions[name, 1]
        pd.testing.assert_frame_equal(mine.table, other.table, check_exact=True)
        assert mine.notes == other.notes
        acted += bool(mine.notes["used"])
    assert acted >= len(raw) - 1


def test_poison_before_the_outage_would_show(make_recipe: MakeRecipe) -> None:
    """The test above can fail: a few absurd fixes just before the outage move every method."""
    recipe = make_recipe(filter={"gate": {"probability": 1.0}})
    drive = prepare_drive(recipe)
    outage = drive.placement.outages[0]
    clean = solved(recipe, drive.log, (outage,))
    spoilt = solved(recipe, poisoned(drive.log, outage.start - 3.0), (outage,))
    for name in recipe.methods:
        moved = (
            spoilt.solutions[name, 1].table["lat"] - clean.solutions[name, 1].table["lat"]
        ).abs()
        assert moved.max() * 6.37e6 > 10.0, name


def moved_between(
    recipe: Recipe, log: DriveLog, outage: Outage, first: float, last: float
) -> set[str]:
    """Methods whose solution moves when the fixes of some seconds, ends included, are absurd."""
    rows = log.fixes["t"].between(first, last)
    assert rows.any()
    spoilt = replace(log, fixes=log.fixes.where(~rows, absurd(log.fixes, first)))
    clean, again = (solved(recipe, one, (outage,)) for one in (log, spoilt))
    return {
        name
        for name in recipe.methods
        if not again.solutions[name, 1].table.equals(clean.solutions[name, 1].table)
        or again.solutions[name, 1].notes != clean.solutions[name, 1].notes
    }


# without a gate absurd fixes are taken, which the filter rightly warns about
@pytest.mark.filterwarnings("ignore:filter. half of the innovations")
def test_smoothing_sees_what_comes_after_the_outage_and_nothing_inside(
    make_recipe: MakeRecipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SmoothedFilter, "sees_after", 40.0)
    methods = ("dead_reckoning", "ekf_plain", "ekf", "rts")
    recipe = make_recipe(methods=methods, filter={"gate": {"probability": 1.0}})
    drive = prepare_drive(recipe)
    outage = drive.placement.outages[0]
    end = outage.end
    assert moved_between(recipe, drive.log, outage, outage.start, end - 1e-3) == set()
    assert moved_between(recipe, drive.log, outage, end, end + 3.0) == {"rts"}
    assert moved_between(recipe, drive.log, outage, end + 40.1, end + 60.0) == set()
    assert moved_between(recipe, drive.log, outage, outage.start - 3.0, end) == set(methods)
