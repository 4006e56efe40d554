"""``navlearn allan``: what it prints, writes and refuses."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.recipe.tuned_spec import read_tuned

RATE = 20.0


def invoke(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exit_code != code:
        raise AssertionError(f"exit {result.exit_code}: {result.output}") from result.exception
    return result.output


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A parked car whose gyros have a random walk of 1e-4 rad/√s."""
    folder = tmp_path_factory.mktemp("bench")
    rng = np.random.default_rng(3)
    t = np.arange(int(300 * RATE)) / RATE
    imu = pd.DataFrame({"t": t})
    for axis in "xyz":
        imu[f"gyro_{axis}"] = 1e-4 * np.sqrt(RATE) * rng.normal(size=t.size)
        imu[f"accel_{axis}"] = 1e-3 * np.sqrt(RATE) * rng.normal(size=t.size)
    imu["accel_z"] += 9.81
    clock = np.arange(0.0, 300.0)
    fixes = pd.DataFrame({"t": clock, "lat": 0.8, "lon": 0.1})
    odometer = pd.DataFrame({"t": clock, "speed": 0.0})
    for name, table in (("imu", imu), ("odometer", odometer), ("fixes", fixes)):
        table.to_csv(folder / f"{name}.csv", index=False)
    return folder


def test_it_prints_coefficients_with_intervals(bench: Path) -> None:
    shown = invoke("allan", bench)
    line = next(line for line in shown.splitlines() if line.startswith("gyro_z    random walk"))
    assert float(line.split()[3]) == pytest.approx(np.degrees(1e-4) * 60.0, rel=0.05)
    assert "°/√h" in line
    assert "below" in shown


def test_it_writes_tables_plot_and_specs_and_replaces_only_by_force(
    bench: Path, tmp_path: Path
) -> None:
    out = tmp_path / "allan"
    invoke("allan", bench, "--from", 10, "--until", 290, "--out", out)
    names = {path.name for path in out.iterdir()} - {".navlearn-run.json"}
    assert names == {"allan.csv", "allan.png", "noise.csv", "tuned_imu.yaml", "tuned_riss.yaml"}
    riss, imu = read_tuned(out / "tuned_riss.yaml"), read_tuned(out / "tuned_imu.yaml")
    assert riss.method == imu.method == "allan"
    assert (riss.sensors, imu.sensors) == ("riss", "imu")
    assert riss.filter["noise"]["gyro_random_walk"] == pytest.approx(1e-4, rel=0.05)
    assert imu.filter["noise"]["accel_random_walk"] == pytest.approx(1e-3, rel=0.05)
    assert len(riss.made_from[0].fingerprint) == 64
    assert (riss.made_from[0].from_s, riss.made_from[0].until_s) == (10.0, 290.0)
    assert "finished run" in invoke("allan", bench, "--out", out, code=2)
    invoke("allan", bench, "--out", out, "--force")
    assert read_tuned(out / "tuned_riss.yaml").made_from[0].until_s != 290.0


def test_what_cannot_be_told_is_refused_in_words(bench: Path, tmp_path: Path) -> None:
    said = invoke("allan", bench, "--from", 290, code=2)
    assert "20 s or more tell a noise" in said
    out = tmp_path / "full"
    out.mkdir()
    (out / "mine.txt").write_text("mine", encoding="utf-8")
    assert "no navlearn run wrote" in invoke("allan", bench, "--out", out, code=2)


def test_a_log_with_one_gyro_gives_one_spec(bench: Path, tmp_path: Path) -> None:
    folder = tmp_path / "one"
    folder.mkdir()
    imu = pd.read_csv(bench / "imu.csv")[["t", "gyro_z"]]
    imu.to_csv(folder / "imu.csv", index=False)
    for name in ("odometer", "fixes"):
        pd.read_csv(bench / f"{name}.csv").to_csv(folder / f"{name}.csv", index=False)
    out = tmp_path / "out"
    said = invoke("allan", folder, "--out", out)
    assert "No tuned_imu.yaml" in said
    assert not (out / "tuned_imu.yaml").exists()
    assert (out / "tuned_riss.yaml").exists()
