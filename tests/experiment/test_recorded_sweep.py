"""Sweeps over several recorded drives: each as it is, as many outages as fit into it."""

from pathlib import Path

import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.sweep import run_sweep
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe.sweep import SweepRecipe, load_sweep

# The filter of a drive of eight minutes has seen too little for its warnings to count.
pytestmark = pytest.mark.filterwarnings("ignore:filter. .*NIS:UserWarning")

SWEEP = """
name: two_drives
question: Does it run?
sweep: {type: recorded, logs: [{path: one}, {path: two}], durations_s: [20, 100]}
methods: [dead_reckoning, ekf]
outages: {count: 3, fewer: true, warm_up_s: 250, min_gap_s: 5, good_before_s: 5}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("recorded")
    for name, duration, seed in (("one", 420.0, 11), ("two", 320.0, 12)):
        made = simulate_drive(
            profile="town", grade="mems_m", duration=duration, seed=seed, imu_rate_hz=10.0,
            name=name,
        )  # fmt: skip
        save_log(made.log, place / name)
    return place


def recipe(folder: Path, text: str = SWEEP) -> SweepRecipe:
    path = folder / "sweep.yaml"
    path.write_text(text, encoding="utf-8")
    return load_sweep(path)


def test_each_drive_has_the_outages_that_fit_and_the_report_names_what_was_left_out(
    folder: Path, tmp_path: Path
) -> None:
    found = run_sweep(recipe(folder), tmp_path / "run", progress=False)
    counts = found.table.groupby(["drive", "duration_s"])["outage"].nunique()
    assert counts["one", 20.0] == 3
    assert 1 <= counts["two", 20.0] < 3
    assert ("one", 100.0) in counts.index
    assert ("two", 100.0) not in counts.index
    assert found.failures == ()
    report = (found.folder / "report.md").read_text(encoding="utf-8")
    assert "2 recorded drives." in report
    assert "left out, because no outage fits: 100 s, two: 3 outages of 100 s were asked" in report


def test_two_drives_of_one_name_are_refused(folder: Path, tmp_path: Path) -> None:
    text = SWEEP.replace("{path: two}", "{path: one}")
    with pytest.raises(ConfigError, match="two of its logs are named 'one'"):
        run_sweep(recipe(folder, text), tmp_path / "run", progress=False)


def test_where_no_outage_fits_anywhere_nothing_is_run(folder: Path, tmp_path: Path) -> None:
    text = SWEEP.replace("[20, 100]", "[300]")
    with pytest.raises(LogError, match="no outage fits into any of the drives"):
        run_sweep(recipe(folder, text), tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_aiding_is_drawn_anew_for_every_drive_and_own_aiding_stays(folder: Path) -> None:
    text = SWEEP.replace("durations_s", "aiding: {seed: 5}, durations_s").replace(
        "{path: two}", "{path: two, aiding: {seed: 9}}"
    )
    sweep = recipe(folder, text).sweep
    seeds = [sweep.source(number).aiding.seed for number in sweep.seeds]
    assert seeds == [5, 9]
    assert recipe(folder, text).shortened(drives=1).sweep.drives == 1
