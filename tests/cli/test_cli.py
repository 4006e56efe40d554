"""The command line: what it says, what it writes, with which code it leaves."""

import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import torch
from typer.testing import CliRunner

from navlearn import __version__
from navlearn.cli import app
from navlearn.logs.reading import read_log
from navlearn.recipe.fixed_methods import FIXED_METHODS
from navlearn.recipe.spec import BUILT_IN

COMMANDS = (
    "check",
    "allan",
    "simulate",
    "methods",
    "run",
    "train",
    "tune",
    "evaluate",
    "export",
    "predict",
)


def invoke(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exit_code != code:
        raise AssertionError(f"exit {result.exit_code}: {result.output}") from result.exception
    return result.output


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives") / "town"
    invoke("simulate", "--profile", "town", "--duration", 240, "--seed", 3, "--out", folder)
    return folder


def test_help_names_every_command() -> None:
    shown = invoke("--help")
    for command in COMMANDS:
        assert command in shown
        assert "--help" in invoke(command, "--help")


def test_version() -> None:
    assert invoke("--version").strip() == f"navlearn {__version__}"


def test_help_is_quick_because_nothing_heavy_is_imported() -> None:
    program = (
        "import sys\n"
        "from navlearn.cli import app\n"
        "heavy = {'torch', 'pandas', 'lightning', 'matplotlib', 'scipy'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)\n"
    )
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert time.perf_counter() - begin < 5.0


def test_module_form_is_the_same_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "navlearn", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == f"navlearn {__version__}"


def test_simulated_drive_is_seeded_and_never_overwritten(drive: Path, tmp_path: Path) -> None:
    invoke("simulate", "--profile", "town", "--duration", 240, "--seed", 3, "--out", tmp_path)
    first, again = read_log(drive), read_log(tmp_path)
    pd.testing.assert_frame_equal(first.imu, again.imu)
    assert first.duration == pytest.approx(240.0, abs=0.1)
    assert first.metadata.is_truth
    refused = invoke("simulate", "--duration", 60, "--out", drive, code=2)
    assert "would be overwritten" in refused
    invoke("simulate", "--duration", 60, "--seed", 4, "--out", tmp_path, "--force")
    assert read_log(tmp_path).duration == pytest.approx(60.0, abs=0.1)


def test_sample_is_the_drive_that_ships(tmp_path: Path) -> None:
    invoke("simulate", "--sample", "--out", tmp_path / "sample")
    shipped = Path(__file__).resolve().parents[2] / "datasets" / "sample_drive"
    made, expected = read_log(tmp_path / "sample"), read_log(shipped)
    pd.testing.assert_frame_equal(made.odometer, expected.odometer, rtol=0.0, atol=2e-3)
    assert made.metadata.name == expected.metadata.name


def test_unknown_grade_and_profile_are_refused(tmp_path: Path) -> None:
    assert "mems_m" in invoke("simulate", "--grade", "mems_q", "--out", tmp_path / "a", code=2)
    assert "town" in invoke("simulate", "--profile", "twn", "--out", tmp_path / "a", code=2)
    assert not (tmp_path / "a").exists()


def test_check_prints_figures(drive: Path) -> None:
    shown = invoke("check", drive)
    assert "usable" in shown
    assert "odometer" in shown


def test_check_fits_into_a_hundred_columns(drive: Path) -> None:
    shown = invoke("check", drive, "--format", "navlearn")
    assert shown == invoke("check", drive, "--format", "native")
    assert max(map(len, shown.splitlines())) <= 100


def test_interrupted_commands_say_what_happens_next(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("navlearn.logs.reading.read_log", interrupt)
    monkeypatch.setattr("navlearn.experiment.run_recipe", interrupt)
    assert invoke("check", drive, code=130).strip() == "navlearn: interrupted"
    shown = invoke("evaluate", drive, "--out", tmp_path / "run", code=130)
    assert "interrupted: the same command goes on where it stopped" in shown


def test_messages_go_to_stderr_without_traceback(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["check", str(tmp_path / "absent")])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("navlearn: ")
    assert "Traceback" not in result.stderr


def test_debug_lets_the_error_through(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["--debug", "check", str(tmp_path / "absent")])
    assert isinstance(result.exception, FileNotFoundError)


def test_export_says_what_is_missing(tmp_path: Path) -> None:
    assert "no run with models" in invoke("export", tmp_path, "--to", "p.pt", code=2)
    (tmp_path / "models").mkdir()
    torch.save({}, tmp_path / "models" / "other.pt")
    torch.save({}, tmp_path / "models" / "other_example.pt")
    shown = invoke("export", tmp_path, "--to", "p.pt", code=2)
    assert "no model 'anarx'" in shown
    assert "found other:" in shown
    assert ".pt2" in invoke("export", tmp_path, "--to", "p.onnx", code=2)


def test_every_method_that_a_recipe_takes_is_listed() -> None:
    listed = invoke("methods").split("\n\n")[0]
    named = [line.split()[0] for line in listed.splitlines()]
    assert named == [*FIXED_METHODS, *BUILT_IN]
