"""Drives whose descriptor names RINEX files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.logs.formats.rinex import RinexRanges
from navlearn.logs.reading import read_log

DESCRIPTOR = """
name: day
format: csv
path: .
tables:
  imu: {file: imu.csv}
  ranges:
    file: day.obs
    clock_start: 2023-06-24T23:59:42Z
"""


@pytest.fixture
def drive(files: Any, read: Callable[..., RinexRanges], tmp_path: Path) -> Callable[[str], Path]:
    def made(more: str) -> Path:
        read()
        rows = "".join(f"{files.OF_WEEK + 0.1 * k},0.01\n" for k in range(21))
        (tmp_path / "imu.csv").write_text("t,gyro_z\n" + rows)
        (tmp_path / "day.yaml").write_text(DESCRIPTOR + more)
        return tmp_path / "day.yaml"

    return made


def test_a_drive_log_by_descriptor(files: Any, drive: Callable[[str], Path]) -> None:
    log = read_log(drive("    navigation: day.nav\n    codes: {E: [C1X], G: [C1W, C1C]}\n"))
    assert log.ranges is not None
    np.testing.assert_array_equal(log.ranges["t"], np.repeat([0.0, 1.0], 4))
    assert log.metadata.gps_time_origin == 2268 * 604800.0 + files.OF_WEEK
    assert len(log.metadata.klobuchar) == 8
    assert log.metadata.range_corrections == ()
    assert log.metadata.extra["receiver"]["ranges"]["format"] == "rinex"
    assert log.metadata.extra["files"]["ranges"] == "day.obs"


def test_a_descriptor_without_navigation(drive: Callable[[str], Path]) -> None:
    with pytest.raises(ConfigError, match=r"tables.ranges: .* no orbits; state navigation"):
        read_log(drive(""))
    with pytest.raises(FileNotFoundError, match=r"other.nav: no such file"):
        read_log(drive("    navigation: other.nav\n"))
    with pytest.raises(ConfigError, match=r"codes\.X"):
        read_log(drive("    navigation: day.nav\n    codes: {X: [C1C]}\n"))


def test_a_clock_that_is_another(drive: Callable[[str], Path]) -> None:
    path = drive("    navigation: day.nav\n")
    path.write_text(path.read_text().replace("2023-06-24T23:59:42Z", "2023-06-25T00:00:42Z"))
    with pytest.raises(LogError, match=r"day.obs: ranges from .* no time in common; state clock"):
        read_log(path)


def test_rinex_gives_ranges_alone(drive: Callable[[str], Path]) -> None:
    with pytest.raises(ConfigError, match=r"tables.fixes: .* \(rinex\) gives ranges alone"):
        read_log(drive("    navigation: day.nav\n  fixes: {file: day.obs}\n"))
