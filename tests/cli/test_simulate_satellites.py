"""``navlearn simulate --satellites``: ranges in the log, their truth beside it."""

from pathlib import Path

from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.logs.formats.native import load_log
from navlearn.logs.range_truth import load_range_truth


def invoke(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["simulate", *(str(argument) for argument in arguments)])
    assert result.exit_code == code, result.output
    return result.output


def test_a_drive_with_ranges_and_their_truth(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    asked = ("--profile", "town", "--duration", 60, "--seed", 11, "--out", folder)
    invoke(*asked, "--satellites", "suburban")
    log = load_log(folder)
    assert log.ranges is not None
    assert len(load_range_truth(folder).of(log).table) == len(log.ranges) > 300
    invoke(*asked, "--force")
    assert sorted(path.name for path in folder.iterdir()) == [
        "fixes.csv.gz",
        "imu.csv.gz",
        "log.json",
        "odometer.csv.gz",
        "reference.csv.gz",
        "sensor_truth.csv.gz",
    ]


def test_an_unknown_sky_is_refused(tmp_path: Path) -> None:
    said = invoke("--satellites", "open_skye", "--duration", 60, "--out", tmp_path / "d", code=2)
    assert "did you mean 'open_sky'" in said
    assert not (tmp_path / "d").exists()
