"""The drive that ships in datasets/ is what the simulator makes today."""

from pathlib import Path

import numpy as np
import pytest

from navlearn.errors import OutputExistsError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import load_log
from navlearn.logs.reading import read_log
from navlearn.logs.synthetic.sample import (
    DECIMALS,
    main,
    make_sample_drive,
    rounded,
    sample_drive,
)
from navlearn.logs.synthetic.simulate import simulate_drive
from navlearn.logs.synthetic.simulated_drive import SimulatedDrive

DATASETS = Path(__file__).resolve().parents[3] / "datasets"


@pytest.fixture(scope="module")
def shipped() -> DriveLog:
    return read_log(DATASETS / "sample_drive.yaml")


@pytest.fixture(scope="module")
def made() -> SimulatedDrive:
    return sample_drive()


def test_shipped_equals_made(shipped: DriveLog, made: SimulatedDrive) -> None:
    """On other platforms sines may differ in the last bit, and a value may round the other way."""
    fresh = rounded(made.log)
    for name, table in fresh.tables().items():
        kept = shipped.tables()[name]
        assert list(kept) == list(table)
        assert len(kept) == len(table)
        for column in table:
            step = max(10.0 ** -DECIMALS[str(column)], _sensor_step(str(column)))
            difference = np.abs(kept[column].to_numpy() - table[column].to_numpy())
            assert difference.max() <= 1.5 * step, (name, column)
            assert (difference > 1e-12).mean() < 1e-3, (name, column)
    assert shipped.metadata == fresh.metadata


def _sensor_step(column: str) -> float:
    return {"speed": 0.05 / 3.6, "gyro": 1e-4, "acce": 2.5e-3}.get(
        column if column == "speed" else column[:4], 0.0
    )


def test_rounding_keeps_what_matters(shipped: DriveLog, made: SimulatedDrive) -> None:
    truth, kept = made.log.reference, shipped.reference
    assert truth is not None
    assert kept is not None
    assert np.abs(kept["lat"] - truth["lat"]).max() * 6.4e6 < 1e-3
    assert np.abs(shipped.imu["gyro_z"] - made.log.imu["gyro_z"]).max() < 6e-6


def test_it_is_small_and_has_what_a_first_run_needs(shipped: DriveLog) -> None:
    files = list((DATASETS / "sample_drive").iterdir())
    assert sum(f.stat().st_size for f in files) < 1_000_000
    assert 30 * 60 <= shipped.duration <= 35 * 60
    speed = shipped.odometer["speed"].to_numpy()
    assert speed.max() * 3.6 > 100.0
    standing = (speed == 0.0).astype(int)
    assert np.sum(np.diff(standing) == 1) >= 15
    assert shipped.metadata.is_truth
    assert shipped.metadata.license == "Apache-2.0"


def test_the_gyro_error_is_worth_learning(made: SimulatedDrive) -> None:
    bias = made.gyro_errors.coefficients["turn_on_bias"]
    learnable = np.std(made.gyro_deterministic_error - bias)
    white = np.std(made.gyro_errors.stochastic["white"])
    assert learnable > 5.0 * white


def test_the_command_writes_it_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = simulate_drive(profile="town", duration=60.0, imu_rate_hz=10.0)
    monkeypatch.setattr("navlearn.logs.synthetic.sample.sample_drive", lambda: short)
    assert main([str(tmp_path / "drive")]) == 0
    written = load_log(tmp_path / "drive")
    expected = rounded(short.log)
    for name, table in written.tables().items():
        assert table.equals(expected.tables()[name]), name
    assert written.metadata == short.log.metadata
    with pytest.raises(OutputExistsError):
        make_sample_drive(tmp_path / "drive")
    make_sample_drive(tmp_path / "drive", force=True)


def test_the_command_explains_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert main(["--help"]) == 2
    assert "sample FOLDER" in capsys.readouterr().err
