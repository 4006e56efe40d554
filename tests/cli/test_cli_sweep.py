"""Sweeps by command: a quick look, what it prints, and its exit code."""

from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.logs.formats.native import load_log
from navlearn.logs.reading import read_sensor_truth

SWEEP = """\
name: few
question: Does it run?
sweep:
  type: simulated
  profile: town
  duration_s: 420
  grades: [mems_x]
  drives: 5
  first_seed: 11
  durations_s: [20]
methods: [ekf, oracle]
outages: {count: 3, warm_up_s: 250, min_gap_s: 5, good_before_s: 5}
"""


def invoke(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exit_code != code:
        raise AssertionError(f"exit {result.exit_code}: {result.output}") from result.exception
    return result.output


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    path = tmp_path / "few.yaml"
    path.write_text(SWEEP, encoding="utf-8")
    return path


def test_a_quick_look_by_command(sweep: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = ["--drives", 1, "--outages", 2, "--processes", 1, "--quiet"]
    shown = invoke("run", sweep, "--out", out, *options)
    table = pd.read_csv(out / "outages.csv")
    assert len(table) == 4
    mean = table.groupby("method")["max_horizontal_error_m"].mean()
    line = next(line for line in shown.splitlines() if line.startswith("oracle"))
    assert line.split()[1] == f"{mean['oracle']:.2f}"
    assert "X 20 s" in shown
    assert str(out / "report.md") in shown
    assert "finished run" in invoke("run", sweep, "--out", out, *options, code=2)
    assert "not in the figures" not in (out / "report.md").read_text(encoding="utf-8")


def test_drives_that_could_not_be_run_show_in_the_exit_code(sweep: Path, tmp_path: Path) -> None:
    sweep.write_text(SWEEP.replace("[20]", "[20, 150]"), encoding="utf-8")
    options = ["--drives", 1, "--outages", 2, "--processes", 1, "--quiet"]
    shown = invoke("run", sweep, "--out", tmp_path / "run", *options, code=1)
    assert "not run: mems_x seed 11, 150 s: LogError" in shown
    assert len(pd.read_csv(tmp_path / "run" / "outages.csv")) == 4


def test_what_belongs_to_sweeps_is_refused_elsewhere(tmp_path: Path) -> None:
    recipe = tmp_path / "one.yaml"
    recipe.write_text("name: one\nlog: {path: nowhere}\n", encoding="utf-8")
    shown = invoke("run", recipe, "--out", tmp_path / "run", "--drives", 2, code=2)
    assert "--drives: for sweeps only" in shown
    assert not (tmp_path / "run").exists()


def test_simulate_keeps_the_truth_of_the_gyro_beside_the_log(tmp_path: Path) -> None:
    options = ["--profile", "town", "--duration", 90, "--seed", 3]
    invoke("simulate", *options, "--out", tmp_path / "drive")
    truth, log = read_sensor_truth(tmp_path / "drive"), load_log(tmp_path / "drive")
    assert truth is not None
    assert truth.t.tolist() == log.imu["t"].tolist()
    assert (tmp_path / "drive" / "sensor_truth.csv.gz").is_file()
