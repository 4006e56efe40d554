"""From a drive to a predictor by commands alone: evaluate, train, export, predict."""

from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.export import load_predictor
from navlearn.recipe import load_recipe

SPEC = """\
name: tiny
acts_on: position
inputs: [yaw_rate, speed, delay]
lags: 1
hidden: 2
max_iterations: 2
starts: 1
safeguard: {gate: false}
"""


def invoke(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exit_code != code:
        raise AssertionError(f"exit {result.exit_code}: {result.output}") from result.exception
    return result.output


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("home")
    options = ["--profile", "suburb", "--grade", "mems_x", "--duration", 900, "--seed", 6]
    invoke("simulate", *options, "--out", folder / "drive")
    (folder / "tiny.yaml").write_text(SPEC)
    return folder


@pytest.fixture(scope="module")
def run(home: Path) -> Path:
    options = ["--outages", "1x30", "--warm-up", 760, "--methods", "dead_reckoning,ekf,tiny"]
    shown = invoke(
        "evaluate",
        home / "drive",
        *options,
        *["--model", home / "tiny.yaml", "--out", home / "run", "--quiet"],
    )
    assert "dead_reckoning" in shown
    assert "Against ekf, the mean error of tiny is" in shown
    assert max(map(len, shown.splitlines()[:-1])) <= 100
    assert str(home / "run" / "report.md") in shown
    return home / "run"


def test_evaluate_writes_the_run(run: Path) -> None:
    for name in ("outages.csv", "summary.json", "report.md", "recipe.yaml"):
        assert (run / name).stat().st_size > 0
    table = pd.read_csv(run / "outages.csv")
    assert list(table["method"]) == ["dead_reckoning", "ekf", "tiny"]
    assert (table["duration_s"] == 30.0).all()
    assert (table["start_s"] >= 760.0).all()


def test_finished_run_is_left_alone(run: Path) -> None:
    before = (run / "outages.csv").read_bytes()
    said = invoke("run", run / "recipe.yaml", "--out", run, "--quiet", code=2)
    assert "force" in said
    assert (run / "outages.csv").read_bytes() == before


def test_resolved_recipe_gives_the_same_table_again(run: Path, home: Path) -> None:
    invoke("run", run / "recipe.yaml", "--out", home / "again", "--quiet")
    first, again = (pd.read_csv(folder / "outages.csv") for folder in (run, home / "again"))
    pd.testing.assert_frame_equal(first, again, rtol=1e-9)
    assert load_recipe(home / "again" / "recipe.yaml") == load_recipe(run / "recipe.yaml")


def test_export_and_predict(run: Path, home: Path) -> None:
    shown = invoke("export", run, "--model", "tiny", "--to", home / "tiny.pt")
    assert "step against forward" in shown
    about = load_predictor(home / "tiny.pt").metadata
    assert about.inputs == ("yaw_rate", "speed", "delay")
    assert about.outputs == ("along", "cross")
    assert "force" in invoke("export", run, "--model", "tiny", "--to", home / "tiny.pt", code=2)
    options = ["--from", 600, "--to", 630, "--out", home / "predictions.csv"]
    invoke("predict", home / "tiny.pt", home / "drive", *options)
    table = pd.read_csv(home / "predictions.csv")
    assert len(table) == 30
    assert table["predicted_along"].abs().max() > 0.0


def test_train_fits_a_drive_without_outages(home: Path) -> None:
    options = ["--methods", "tiny", "--model", home / "tiny.yaml", "--quiet"]
    shown = invoke("train", home / "drive", *options, "--out", home / "trained")
    assert "emulated outages that it had not seen" in shown
    assert "models" in shown
    assert (home / "trained" / "models" / "tiny.pt").is_file()
    invoke("export", home / "trained", "--model", "tiny", "--to", home / "trained.pt")
    trained_on = load_predictor(home / "trained.pt").metadata.trained_on
    assert trained_on["regime"] == "other-drives"


def test_train_takes_a_descriptor_or_a_recipe(run: Path, home: Path) -> None:
    (home / "drive.yaml").write_text("name: drive\nformat: native\npath: drive\n")
    options = ["--methods", "tiny", "--model", home / "tiny.yaml", "--quiet"]
    invoke("train", home / "drive.yaml", *options, "--out", home / "by_descriptor")
    invoke("train", run / "recipe.yaml", "--quiet", "--out", home / "by_recipe")
    for folder in ("by_descriptor", "by_recipe"):
        assert (home / folder / "models" / "tiny.pt").is_file()
