"""A predictor on a drive: the same inputs and corrections as the library makes itself."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from torch import Tensor
from typer.testing import CliRunner

from navlearn.cli import app
from navlearn.error_models.base import FittedErrorModel, TrainingSource
from navlearn.error_models.storage import save_error_model
from navlearn.errors import ConfigError
from navlearn.export import export_predictor, load_predictor, predict_drive
from navlearn.export.example import save_example
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic.simulate import simulate_drive

Fitted = Callable[..., FittedErrorModel]
Inputs = Callable[..., Tensor]


@pytest.fixture(scope="module")
def drive() -> DriveLog:
    return simulate_drive(
        profile="town", grade="ideal", duration=200.0, seed=1, imu_rate_hz=10.0
    ).log


@pytest.fixture
def predictor(tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs) -> Path:
    path = tmp_path / "predictor.pt"
    export_predictor(make_fitted(), path, check_inputs=make_inputs())
    return path


def test_inputs_are_means_over_steps_since_the_start(
    drive: DriveLog, predictor: Path, make_fitted: Fitted
) -> None:
    table = predict_drive(load_predictor(predictor), drive, start=100.0, stop=130.0)
    np.testing.assert_allclose(table["t"], np.arange(101.0, 131.0), atol=1e-6)
    np.testing.assert_allclose(table["delay"], np.arange(1, 31) / 60.0, atol=1e-9)
    imu = drive.imu
    for row in (0, 17, 29):
        step = imu[(imu["t"] > 100.05 + row) & (imu["t"] < 101.05 + row)]
        assert table["yaw_rate"][row] == pytest.approx(step["gyro_z"].mean(), abs=2e-3)
        where = (drive.odometer["t"] - 100.5 - row).abs().idxmin()
        assert table["speed"][row] == pytest.approx(drive.odometer["speed"][where], abs=0.3)
    inputs = torch.tensor(table[["yaw_rate", "speed", "delay"]].to_numpy())
    expected = make_fitted().model(inputs).detach().numpy()
    found = table[["predicted_along", "predicted_cross"]].to_numpy()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    total = table[["total_along", "total_cross"]].to_numpy()
    np.testing.assert_allclose(total, expected.cumsum(0), rtol=0.0, atol=1e-9)


def test_fixes_after_the_start_do_not_matter(drive: DriveLog, predictor: Path) -> None:
    loaded = load_predictor(predictor)
    whole = predict_drive(loaded, drive, start=100.0, stop=130.0)
    blind = predict_drive(loaded, drive.without_fixes_from(100.0), start=100.0, stop=130.0)
    pd.testing.assert_frame_equal(whole, blind)


@pytest.mark.parametrize(
    ("start", "stop"), [(130.0, 100.0), (-20.0, 30.0), (100.0, 999.0), (100.0, 100.4)]
)
def test_times_outside_the_log_are_refused(
    drive: DriveLog, predictor: Path, start: float, stop: float
) -> None:
    with pytest.raises(ConfigError, match=r"predict from"):
        predict_drive(load_predictor(predictor), drive, start=start, stop=stop)


def test_inputs_that_no_log_has_are_refused(
    drive: DriveLog, tmp_path: Path, make_fitted: Fitted, make_inputs: Inputs
) -> None:
    source = TrainingSource(
        inputs=("azimuth_estimate", "speed", "delay"),
        outputs=("azimuth",),
        acts_on="azimuth",
        input_units=("rad", "m/s", "60 s"),
    )
    fitted = make_fitted(kind="fos", source=source)
    export_predictor(fitted, tmp_path / "p.pt", check_inputs=make_inputs())
    with pytest.raises(ConfigError, match="azimuth_estimate are not made from a log alone"):
        predict_drive(load_predictor(tmp_path / "p.pt"), drive, start=100.0, stop=130.0)


@pytest.mark.parametrize("kind", ["fos", "pci"])
@pytest.mark.parametrize("suffix", [".pt", ".pt2"])
def test_fitters_of_a_run_are_exported_and_replayed(
    kind: str,
    suffix: str,
    drive: DriveLog,
    tmp_path: Path,
    make_fitted: Fitted,
    make_inputs: Inputs,
) -> None:
    fitted, run = make_fitted(kind=kind), tmp_path / "run"
    save_error_model(fitted, run / "models" / f"{kind}.pt")
    save_example(make_inputs(), run / "models" / f"{kind}_example.pt")
    predictor, out = tmp_path / f"predictor{suffix}", tmp_path / "predictions.csv"
    folder = save_log(drive, tmp_path / "log")
    commands = (
        ["export", str(run), "--model", kind, "--to", str(predictor)],
        ["predict", str(predictor), str(folder), "--from", "100", "--to", "120", "--out", str(out)],
    )
    for command in commands:
        done = CliRunner().invoke(app, command)
        assert done.exit_code == 0, done.output
    table = pd.read_csv(out)
    inputs = torch.tensor(table[["yaw_rate", "speed", "delay"]].to_numpy())
    expected = fitted.model(inputs).detach().numpy()[:, 0]
    np.testing.assert_allclose(table["predicted_yaw_rate_error"], expected, rtol=0.0, atol=1e-12)
    # A rate is no increment: nothing is summed.
    assert not [name for name in table.columns if name.startswith("total_")]


def test_command_writes_the_table_once(drive: DriveLog, predictor: Path, tmp_path: Path) -> None:
    folder, out = save_log(drive, tmp_path / "log"), tmp_path / "deep" / "predictions.csv"
    command = ["predict", str(predictor), str(folder), "--from", "100", "--to", "120"]
    command += ["--out", str(out)]
    first = CliRunner().invoke(app, command)
    assert first.exit_code == 0, first.output
    expected = predict_drive(load_predictor(predictor), drive, start=100.0, stop=120.0)
    pd.testing.assert_frame_equal(pd.read_csv(out), expected)
    again = CliRunner().invoke(app, command)
    assert again.exit_code == 2
    assert "--force" in again.stderr
    assert CliRunner().invoke(app, [*command, "--force"]).exit_code == 0
