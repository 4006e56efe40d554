"""Sweeps: every drive of every class, gone on with where they stopped, failures told."""

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import yaml

from navlearn.errors import ConfigError, FitError, LogError, OutputExistsError
from navlearn.experiment import run_recipe, sweep, sweep_jobs
from navlearn.experiment.sweep import SweepResult, run_sweep
from navlearn.experiment.sweep_drives import make_drive
from navlearn.experiment.sweep_jobs import SweepJob, read_rows, rows_file
from navlearn.experiment.timed_method import TimedMethod
from navlearn.logs.formats.native import save_log
from navlearn.outages.known_log import sees_after
from navlearn.recipe.strict import parse
from navlearn.recipe.sweep import SweepRecipe
from navlearn.recipe.swept_drives import Conditions

# The filter of a drive of eight minutes has seen too little for its warnings to count.
pytestmark = pytest.mark.filterwarnings("ignore:filter. .*NIS:UserWarning")

DRIVES: dict[str, Any] = {
    "type": "simulated",
    "profile": "town",
    "duration_s": 420.0,
    "grades": ["mems_x", "tactical"],
    "drives": 2,
    "first_seed": 11,
    "durations_s": [20.0, 30.0],
}


def sweep_of(**entries: Any) -> SweepRecipe:
    content: dict[str, Any] = {
        "name": "few",
        "question": "Does it run?",
        "sweep": {**DRIVES, **entries.pop("sweep", {})},
        "methods": ["dead_reckoning", "ekf", "oracle"],
        "outages": {"count": 2, "warm_up_s": 250.0, "min_gap_s": 5.0, "good_before_s": 5.0},
        **entries,
    }
    return parse(SweepRecipe, content, file="test")


def without_times(table: pd.DataFrame) -> pd.DataFrame:
    return table.drop(columns=["cpu_s"])


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> SweepResult:
    return run_sweep(sweep_of(), tmp_path_factory.mktemp("sweeps") / "run", progress=False)


def test_every_class_drive_length_and_method_has_its_rows(done: SweepResult) -> None:
    table = done.table
    assert done.failures == ()
    counts = table.groupby(["gyro_class", "duration_s", "drive", "method"]).size()
    assert len(counts) == 2 * 2 * 2 * 3
    assert (counts == 2).all()
    assert set(table["gyro_class"]) == {"X", "T"}
    assert table["drive"].nunique() == 4
    assert (table["cpu_s"] > 0.0).all()
    written = pd.read_csv(done.folder / "outages.csv")
    assert len(written) == len(table)
    for name in ("summary.json", "report.md", "cells.csv", "recipe.yaml"):
        assert (done.folder / name).stat().st_size > 0
    report = (done.folder / "report.md").read_text(encoding="utf-8")
    assert "Simulated drives: 2 per class of 420 s, profile `town`, seeds 11 to 12" in report
    assert "s of processor time per outage" in report
    assert "**Time.**" in report


def test_a_drive_alone_gives_the_same_figures(done: SweepResult, tmp_path: Path) -> None:
    recipe = sweep_of()
    log, truth = make_drive(recipe, "mems_x", 12)
    folder = save_log(log, tmp_path / "drive", truth=truth)
    alone = recipe.for_drive("any", 30.0)
    source = alone.log.model_copy(update={"path": folder})
    single = run_recipe(
        alone.model_copy(update={"log": source}), tmp_path / "run", progress=False
    ).table
    swept = done.table[
        (done.table["drive"] == log.metadata.name) & (done.table["duration_s"] == 30.0)
    ].reset_index(drop=True)
    figures = [name for name in single.columns if single[name].dtype == "float64"]
    pd.testing.assert_frame_equal(swept[figures], single[figures], rtol=1e-5, atol=1e-5)
    assert list(swept["method"]) == list(single["method"])


def test_several_processes_give_the_same_table(done: SweepResult, tmp_path: Path) -> None:
    again = run_sweep(sweep_of(), tmp_path / "run", processes=2, progress=False)
    pd.testing.assert_frame_equal(without_times(again.table), without_times(done.table))


def test_an_interrupted_sweep_goes_on(
    done: SweepResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, int]] = []

    def interrupted(job: SweepJob) -> list[sweep_jobs.Failure]:
        asked.append((job.grade, job.seed))
        if len(asked) == 3:
            raise KeyboardInterrupt
        return sweep_jobs.run_job(job)

    monkeypatch.setattr(sweep, "run_job", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep_of(), tmp_path / "run", progress=False)
    assert asked[:2] == [("mems_x", 11), ("tactical", 11)]
    again = run_sweep(sweep_of(), tmp_path / "run", progress=False)
    assert asked[3:] == [("mems_x", 12), ("tactical", 12)]
    pd.testing.assert_frame_equal(without_times(again.table), without_times(done.table))
    with pytest.raises(OutputExistsError, match="finished run"):
        run_sweep(sweep_of(), tmp_path / "run", progress=False)


def test_a_drive_that_fails_is_told_and_tried_again(
    done: SweepResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def make(recipe: SweepRecipe, grade: str, seed: int) -> Any:
        if (grade, seed) == ("tactical", 12):
            raise LogError("the road is flooded")
        return make_drive(recipe, grade, seed)

    with monkeypatch.context() as patch:
        patch.setattr(sweep_jobs, "make_drive", make)
        found = run_sweep(sweep_of(), tmp_path / "run", progress=False)
    assert [(one.grade, one.seed, one.duration) for one in found.failures] == [
        ("tactical", 12, 20.0),
        ("tactical", 12, 30.0),
    ]
    assert found.failures[0].reason == "LogError: the road is flooded"
    report = (found.folder / "report.md").read_text(encoding="utf-8")
    assert "**Not run** (2), and not in the figures: tactical seed 12, 20 s" in report
    assert len(found.table) == len(done.table) * 3 // 4
    again = run_sweep(sweep_of(), tmp_path / "run", progress=False)
    assert again.failures == ()
    pd.testing.assert_frame_equal(without_times(again.table), without_times(done.table))


def test_where_nothing_fits_nothing_is_reported(tmp_path: Path) -> None:
    crowded = sweep_of(outages={"count": 50, "warm_up_s": 250.0})
    with pytest.raises(FitError, match=r"no drive could be run.*50 outages of 20 s were asked"):
        run_sweep(crowded, tmp_path / "run", progress=False)
    with pytest.raises(ConfigError, match="processes: found 0"):
        run_sweep(crowded, tmp_path / "other", processes=0, progress=False)


def test_rows_belong_to_their_settings(tmp_path: Path) -> None:
    recipe = sweep_of()
    name = rows_file(recipe, "mems_x", 11, Conditions(20.0), "")
    same = sweep_of(sweep={"drives": 9, "first_seed": 5, "grades": ["mems_x"]}, name="other")
    assert rows_file(same, "mems_x", 11, Conditions(20.0), "") == name
    few, fewer = (sweep_of(sweep={"satellites": numbers}) for numbers in ([3, 0], [3, 1, 0]))
    kind = Conditions(20.0, 3)
    assert rows_file(few, "mems_x", 11, kind, "") == rows_file(fewer, "mems_x", 11, kind, "")
    others = [
        rows_file(recipe, "mems_x", 11, Conditions(20.0), "another real drive"),
        rows_file(recipe, "mems_x", 12, Conditions(20.0), ""),
        rows_file(recipe, "mems_x", 11, Conditions(30.0), ""),
        rows_file(
            sweep_of(filter={"noise": {"turn_noise": 0.01}}), "mems_x", 11, Conditions(20.0), ""
        ),
        rows_file(sweep_of(sweep={"duration_s": 430.0}), "mems_x", 11, Conditions(20.0), ""),
        rows_file(sweep_of(methods=["ekf", "anarx"]), "mems_x", 11, Conditions(20.0), ""),
        rows_file(recipe, "mems_x", 11, Conditions(20.0, 1), ""),
        # outages in which three satellites could stay are others than those in which one could
        rows_file(sweep_of(sweep={"satellites": [3, 0]}), "mems_x", 11, Conditions(20.0), ""),
    ]
    assert len({name, *others}) == len(others) + 1


def test_rows_come_back_as_they_were(done: SweepResult) -> None:
    files = sorted((done.folder / "rows").glob("*.csv"))
    assert len(files) == 8
    back = pd.concat([read_rows(file) for file in files], ignore_index=True)
    order = ["drive", "duration_s", "method", "outage"]
    pd.testing.assert_frame_equal(
        back.sort_values(order, ignore_index=True), done.table.sort_values(order, ignore_index=True)
    )
    assert not list((done.folder / "rows").glob("*.part"))


def test_a_real_drive_with_a_synthetic_gyro(tmp_path: Path) -> None:
    real, _ = make_drive(sweep_of(), "tactical", 13)
    folder = save_log(real, tmp_path / "real")
    content = {
        "sweep": {
            "type": "degraded",
            "log": {"path": folder},
            "grades": ["mems_x"],
            "drives": 2,
            "durations_s": [20.0],
        },
        "methods": ["ekf", "oracle", "noise_free_gyro", "perfect_azimuth"],
    }
    left_out = {"sweep": True, "outages": {"duration_s", "satellites"}}
    base = sweep_of().model_dump(exclude=left_out)
    recipe = parse(SweepRecipe, {**base, **content}, file="test")
    found = run_sweep(recipe, tmp_path / "run", progress=False)
    assert found.table["drive"].unique().tolist() == [
        f"{real.metadata.name}_mems_x_{seed}" for seed in (0, 1)
    ]
    mean = found.table.groupby("method")["max_horizontal_error_m"].mean()
    assert mean["noise_free_gyro"] < mean["ekf"]
    # the real gyro is the same under every error that is added to it
    free = found.table[found.table["method"] == "noise_free_gyro"]
    per_drive = free.groupby("drive")["max_horizontal_error_m"].mean()
    assert per_drive.iloc[0] == pytest.approx(per_drive.iloc[1], rel=0.05)
    report = (found.folder / "report.md").read_text(encoding="utf-8")
    assert "Semi-synthetic: the real drive real with the gyro error" in report


def test_a_timed_method_sees_what_its_method_sees() -> None:
    class Late:
        sees_after = 30.0

    assert sees_after(TimedMethod(Late())) == 30.0  # type: ignore[arg-type]


@pytest.mark.slow
def test_ctrl_c_ends_all_processes_and_keeps_what_is_done(tmp_path: Path) -> None:
    recipe = tmp_path / "few.yaml"
    resolved = sweep_of(sweep={"drives": 30}).resolved()
    recipe.write_text(yaml.safe_dump(resolved), encoding="utf-8")
    command = [sys.executable, "-m", "navlearn", "run", str(recipe), "--out", str(tmp_path / "r")]
    process = subprocess.Popen([*command, "--processes", "2", "--quiet"], stderr=subprocess.PIPE)
    rows = tmp_path / "r" / "rows"
    deadline = time.monotonic() + 300.0
    while not (rows.is_dir() and list(rows.glob("*.csv"))) and time.monotonic() < deadline:
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"the same command goes on where it stopped" in said
    assert list(rows.glob("*.csv"))
    time.sleep(2.0)
    count = len(list(rows.iterdir()))
    time.sleep(5.0)
    assert len(list(rows.iterdir())) == count
