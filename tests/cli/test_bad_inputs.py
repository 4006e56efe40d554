"""Twelve bad inputs, each through the command line: one clear message and an exit code."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic.simulate import simulate_drive

GYROS = ["gyro_x", "gyro_y", "gyro_z"]
REFUSED, RUINED = 2, 1


@pytest.fixture(scope="module")
def drive() -> DriveLog:
    return simulate_drive(
        profile="town", grade="mems_m", duration=420.0, seed=2, imu_rate_hz=10.0
    ).log


def write(drive: DriveLog, folder: Path, **changed: pd.DataFrame) -> Path:
    folder.mkdir()
    for name, table in {**drive.tables(), **changed}.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    return folder


def answer(*arguments: object, code: int) -> str:
    """Return what a command says when it exits with a code, which must be without traceback."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    assert isinstance(result.exception, SystemExit)
    if code == REFUSED:
        assert result.stdout == ""
        assert result.stderr.startswith("navlearn: ")
    return " ".join(result.output.split())


def without_yaw_gyro(imu: pd.DataFrame) -> pd.DataFrame:
    return imu.drop(columns="gyro_z")


def with_nan_block(imu: pd.DataFrame) -> pd.DataFrame:
    block = (imu["t"] > 200.0) & (imu["t"] < 240.0)
    return imu.assign(gyro_z=imu["gyro_z"].mask(block))


def reversed_in_time(imu: pd.DataFrame) -> pd.DataFrame:
    return imu.assign(t=imu["t"].to_numpy()[::-1])


def in_degrees(imu: pd.DataFrame) -> pd.DataFrame:
    return imu.assign(**{name: np.degrees(imu[name]) for name in GYROS})


def with_axes_swapped(imu: pd.DataFrame) -> pd.DataFrame:
    swap = {"x": "z", "z": "x"}
    names = {f"{kind}_{a}": f"{kind}_{b}" for kind in ("gyro", "accel") for a, b in swap.items()}
    return imu.rename(columns=names)


def with_repeated_stamps(imu: pd.DataFrame) -> pd.DataFrame:
    t = imu["t"].to_numpy().copy()
    t[1000:1006] = t[1000]
    return imu.assign(t=t)


def without_rows(imu: pd.DataFrame) -> pd.DataFrame:
    return imu.iloc[:0]


def test_the_sound_drive_passes(drive: DriveLog, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["check", str(write(drive, tmp_path / "sound"))])
    assert result.exit_code == 0, result.output
    assert "usable (0 error" in result.output


def test_missing_file(tmp_path: Path) -> None:
    said = answer("check", tmp_path / "absent", code=REFUSED)
    assert "absent" in said
    assert "does not exist" in said


@pytest.mark.parametrize(
    ("spoil", "code", "words"),
    [
        (without_yaw_gyro, REFUSED, ["imu.csv", "no column gyro_z", "found t, gyro_x"]),
        (with_nan_block, REFUSED, ["gyro_z", "200.1 to 239.9 s", "399 rows"]),
        (reversed_in_time, REFUSED, ["time steps back at row 2", "sort", "on_backstep"]),
        (in_degrees, REFUSED, ["gyro_z", "degrees per second", "unit: deg/s"]),
        (with_axes_swapped, RUINED, ["gravity axis", "swapped gyro axes", "map gyro_x to z"]),
        (with_repeated_stamps, REFUSED, ["row 1002 repeats the time", "5 such rows"]),
        (without_rows, REFUSED, ["imu.csv", "0 rows"]),
    ],
)
def test_spoilt_imu(
    drive: DriveLog,
    tmp_path: Path,
    spoil: Callable[[pd.DataFrame], pd.DataFrame],
    code: int,
    words: list[str],
) -> None:
    said = answer("check", write(drive, tmp_path / "log", imu=spoil(drive.imu)), code=code)
    for word in words:
        assert word in said


def test_kilometres_per_hour_for_metres_per_second(drive: DriveLog, tmp_path: Path) -> None:
    odometer = drive.odometer.assign(speed=3.6 * drive.odometer["speed"])
    said = answer("check", write(drive, tmp_path / "log", odometer=odometer), code=RUINED)
    assert "NOT usable" in said
    assert "km/h: divide by 3.6" in said


def test_degrees_for_radians_in_positions(drive: DriveLog, tmp_path: Path) -> None:
    fixes = drive.fixes.assign(lat=np.degrees(drive.fixes["lat"]))
    said = answer("check", write(drive, tmp_path / "log", fixes=fixes), code=REFUSED)
    assert "lat is 44" in said
    assert "unit: deg" in said


def test_folder_without_a_log(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing here")
    said = answer("check", tmp_path, code=REFUSED)
    assert "no known log format" in said
    assert "notes.txt" in said


@pytest.mark.parametrize("start", [380, 5000])
def test_outage_outside_the_log(drive: DriveLog, tmp_path: Path, start: int) -> None:
    log = write(drive, tmp_path / "log")
    options = ["--times", start, "--outages", "1x60", "--methods", "ekf"]
    said = answer("evaluate", log, *options, "--out", tmp_path / "run", code=REFUSED)
    assert f"outage from {start} to {start + 60} s lies outside the log" in said
    assert "to 420 s" in said


def test_unknown_recipe_key(tmp_path: Path) -> None:
    recipe = tmp_path / "mine.yaml"
    recipe.write_text("name: mine\nlog: {path: log}\noutagse: {count: 1}\n")
    said = answer("run", recipe, "--out", tmp_path / "run", code=REFUSED)
    assert "mine.yaml:3: unknown key 'outagse' (did you mean 'outages'?)" in said
    assert not (tmp_path / "run").exists()


def test_descriptor_for_a_recipe(tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text("name: drive\nformat: csv\npath: drive\n")
    said = answer("run", tmp_path / "drive.yaml", "--out", tmp_path / "run", code=REFUSED)
    assert "descriptor of a log, not a recipe; give it to navlearn evaluate" in said


def test_table_for_a_predictor(drive: DriveLog, tmp_path: Path) -> None:
    log = write(drive, tmp_path / "log")
    options = ["--from", 300, "--to", 360, "--out", tmp_path / "p.csv"]
    said = answer("predict", log / "imu.csv", log, *options, code=REFUSED)
    assert "imu.csv: neither a TorchScript nor a torch.export predictor (no archive" in said


def test_truncated_mat_file(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).random((1000, 7))
    for name in ("f_w_IMSseconds_dt.mat", "INSPVA.mat"):
        savemat(tmp_path / name, {"table": rows})
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    said = answer("check", tmp_path, "--format", "navinst", code=REFUSED)
    assert "f_w_IMSseconds_dt.mat" in said
    assert "truncated or damaged" in said


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--outages", "ten"], "10x60"),
        (["--times", "1,x"], "separated by commas"),
        (["--methods", "efk"], "did you mean 'ekf'"),
        (["--format", "navins"], "did you mean 'navinst'"),
        (["--dims", "4"], "2 or 3"),
        (["--rate", "0"], "mechanization.rate_hz is 0.0; expected greater than 0"),
        (["--placement", "sprad"], "did you mean 'spread'"),
        (["--satellites", "2", "--visible", "higest"], "did you mean 'highest'"),
        (["--visible", "random"], "add --satellites COUNT"),
        (["--satellites", "3", "--visible", "G01,G02"], "visible_satellites lists 2"),
        (["--visible", "G01,2"], "outages.visible_satellites[1]"),
        (["--satellites", "1"], "the log has no raw ranges"),
        (["--model", "absent.yaml"], "no such model spec"),
    ],
)
def test_options_that_are_not_understood(
    drive: DriveLog, tmp_path: Path, options: list[str], words: str
) -> None:
    log = write(drive, tmp_path / "log")
    assert words in answer("evaluate", log, *options, "--out", tmp_path / "run", code=REFUSED)
