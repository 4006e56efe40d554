"""What filters refused over the drives of a sweep: as in single runs, and kept drive by drive."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from navlearn.experiment import run_recipe, sweep, sweep_jobs
from navlearn.experiment.sweep import SweepResult, run_sweep
from navlearn.experiment.sweep_drives import make_drive
from navlearn.experiment.sweep_jobs import SweepJob
from navlearn.experiment.sweep_parts import jobs_of, parts_of, refusals_of
from navlearn.experiment.sweep_sources import sources_of
from navlearn.logs.formats.native import save_log
from navlearn.outages.output import OutputFolder, prepare_output_folder
from navlearn.recipe.strict import parse
from navlearn.recipe.sweep import SweepRecipe

pytestmark = pytest.mark.filterwarnings("ignore:filter. .*NIS:UserWarning")

FILES = ("refused_fixes.csv", "refused_counts.csv", "faults.csv")
FAULTS = {
    "spikes": {"sizes_m": [8, 60], "per_hour": 180, "honest": False},
    "apart_s": 15,
    "settle_s": 100,
}


def sweep_of(*methods: str, **entries: Any) -> SweepRecipe:
    source = {
        "type": "simulated",
        "profile": "town",
        "duration_s": 400.0,
        "grades": ["mems_m"],
        "drives": 2,
        "first_seed": 11,
        "durations_s": [20.0, 30.0],
        **entries,
    }
    content = {
        "name": "refusing",
        "question": "What is refused?",
        "sweep": source,
        "methods": [*methods],
        "integrity": {"probability": 1.0, "prediction_limit": 40.0},
        "outages": {"count": 1, "warm_up_s": 250.0, "min_gap_s": 5.0, "good_before_s": 5.0},
    }
    if "ekf+integrity" not in methods:
        content.pop("integrity")
    return parse(SweepRecipe, content, file="test")


METHODS = ("dead_reckoning", "ekf", "ekf+integrity")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> SweepResult:
    recipe = sweep_of(*METHODS, faults=FAULTS)
    return run_sweep(recipe, tmp_path_factory.mktemp("refused") / "run", progress=False)


def written(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


def test_every_drive_and_filter_is_in_the_files(done: SweepResult) -> None:
    assert done.failures == ()
    fixes, counts, faults = (pd.read_csv(done.folder / name) for name in FILES)
    drives = set(done.table["drive"])
    assert len(drives) == 2
    for table in (fixes, counts, faults):
        assert set(table["gyro_class"]) == {"M"}
        assert set(table["drive"]) == drives
    assert set(fixes["method"]) == set(counts["method"]) == {"ekf", "ekf+integrity"}
    reasons = ["refused_by_gate", "refused_by_prediction", "refused_by_motion"]
    keys = ["drive", "method", "kind"]
    told = fixes[fixes["verdict"].isin(reasons)].groupby([*keys, "verdict"]).size()
    counted = counts.melt(keys, reasons, "verdict", "size").set_index([*keys, "verdict"])["size"]
    assert told.to_dict() == counted[counted > 0].to_dict()
    # only ekf+integrity has a limit of 40 m, and refuses the spikes of 60 m by it
    far = set(zip(*(faults.loc[np.hypot(faults["east"], faults["north"]) > 40.0, name]
                    for name in ("drive", "fault")), strict=True))  # fmt: skip
    assert len(far) > 2
    by = fixes[(fixes["verdict"] == "refused_by_prediction") & (fixes["kind"] == "position")]
    assert set(by["method"]) == {"ekf+integrity"}
    by = by[by["fault"] > 0]
    assert set(zip(by["drive"], by["fault"], strict=True)) == far


def test_a_drive_alone_gives_the_same_tables(done: SweepResult, tmp_path: Path) -> None:
    recipe = sweep_of(*METHODS, faults=FAULTS)
    log, truth = make_drive(recipe, "mems_m", 12)
    folder = save_log(log, tmp_path / "drive", truth=truth)
    alone = recipe.for_drive("any", 20.0, "mems_m")
    source = alone.log.model_copy(update={"path": folder})
    run_recipe(alone.model_copy(update={"log": source}), tmp_path / "run", progress=False)
    for name in FILES:
        swept = pd.read_csv(done.folder / name)
        swept = swept[swept["drive"] == log.metadata.name].drop(columns="gyro_class")
        swept = swept.reset_index(drop=True)
        single = pd.read_csv(tmp_path / "run" / name)
        # a stored log is rounded
        pd.testing.assert_frame_equal(swept[single.columns], single, rtol=1e-4, atol=1e-4)


def test_the_report_adds_up_and_tells_what_was_caught(done: SweepResult) -> None:
    report = (done.folder / "report.md").read_text(encoding="utf-8")
    counts = pd.read_csv(done.folder / "refused_counts.csv")
    mine = counts[(counts["method"] == "ekf+integrity") & (counts["kind"] == "position")]
    by = mine[["measured", "refused_by_gate", "refused_by_prediction"]].sum()
    assert f"| M | ekf+integrity | position | {' | '.join(map(str, by))} |" in report
    fixes, faults = (pd.read_csv(done.folder / name) for name in (FILES[0], FILES[2]))
    refused = fixes[(fixes["method"] == "ekf+integrity") & (fixes["kind"] == "position")]
    refused = refused[refused["verdict"] != "accepted_by_reset"]
    bad = int((refused["fault"] > 0).sum())
    assert 0 < bad < len(faults)
    assert f"| M | ekf+integrity | any fault | {len(faults)} | {bad} |" in report
    good = int(by["measured"]) - len(faults)
    assert f"| M | ekf+integrity | none (good) | {good} | {len(refused) - bad} |" in report


def test_a_resumed_sweep_gives_the_same_files(
    done: SweepResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[SweepJob] = []

    def interrupted(job: SweepJob) -> list[sweep_jobs.Failure]:
        asked.append(job)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return sweep_jobs.run_job(job)

    recipe = sweep_of(*METHODS, faults=FAULTS)
    monkeypatch.setattr(sweep, "run_job", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(recipe, tmp_path / "run", progress=False)
    kept = [
        file for folder in ("rows", "refused") for file in (tmp_path / "run" / folder).iterdir()
    ]
    before = {file: file.stat().st_mtime_ns for file in kept}
    assert len(before) == 3
    run_sweep(recipe, tmp_path / "run", progress=False)
    assert [job.seed for job in asked] == [11, 12, 12]
    assert {file: file.stat().st_mtime_ns for file in kept} == before
    assert written(tmp_path / "run") == written(done.folder)


def test_rows_without_refused_fixes_are_kept_and_those_added(
    done: SweepResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An older run left rows only."""
    recipe = sweep_of(*METHODS, faults=FAULTS)
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run_job", lambda job: sweep_jobs.run_job(replace(job, refused=None)))
        patch.setattr(OutputFolder, "finish", lambda self: None)
        run_sweep(recipe, tmp_path / "run", progress=False)
    assert not (tmp_path / "run" / FILES[0]).exists()

    def replayed(*given: object, **named: object) -> None:
        raise AssertionError("nothing was left to be replayed")

    monkeypatch.setattr(sweep_jobs, "replay", replayed)
    assert run_sweep(recipe, tmp_path / "run", progress=False).failures == ()
    assert written(tmp_path / "run") == written(done.folder)


def test_what_keeps_refused_fixes_from_being_told_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(*given: object) -> None:
        raise ValueError("no such gate")

    monkeypatch.setattr(sweep_jobs, "refusals", lost)
    recipe = sweep_of("ekf", drives=1)
    found = run_sweep(recipe, tmp_path / "run", progress=False)
    assert [(one.seed, one.duration) for one in found.failures] == [(11, 20.0)]
    assert found.failures[0].reason == "ValueError: no such gate"
    assert set(found.table["duration_s"]) == {20.0, 30.0}


def test_without_faults_none_are_told(tmp_path: Path) -> None:
    folder = run_sweep(sweep_of("ekf", drives=1), tmp_path / "run", progress=False).folder
    assert (folder / "refused_counts.csv").exists()
    assert not (folder / "faults.csv").exists()
    assert "Faults put in" not in (folder / "report.md").read_text(encoding="utf-8")


def test_where_no_method_is_a_filter_nothing_is_written(tmp_path: Path) -> None:
    recipe = sweep_of("dead_reckoning", "rts", drives=1)
    output = prepare_output_folder(tmp_path / "run")
    parts = parts_of(recipe, output, sources_of(recipe)[0])
    assert len(parts) == 2
    assert refusals_of(parts) == []
    assert [job.refused for job in jobs_of(recipe, parts)] == [None]
    assert not (tmp_path / "run" / "refused").exists()
