"""The truth of simulated ranges: beside the log, never inside it, and only of its own drive."""

import gzip
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from navlearn.errors import LogError, LogNotFoundError, OutputExistsError
from navlearn.logs.clock import without_latency
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.range_truth import COLUMNS, RANGE_TRUTH, RangeTruth, load_range_truth
from navlearn.logs.synthetic import SimulatedDrive, simulate_drive


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    return simulate_drive(
        profile="town",
        grade="low_cost_obd",
        duration=90.0,
        seed=11,
        imu_rate_hz=10.0,
        satellites="suburban",
    )


def truth_of(drive: SimulatedDrive) -> RangeTruth:
    assert drive.range_truth is not None
    return drive.range_truth


def keys(log: DriveLog) -> pd.DataFrame:
    assert log.ranges is not None
    return log.ranges[["t", "satellite"]].reset_index(drop=True)


def test_it_has_a_row_per_range_and_no_column_of_it_is_in_the_log(drive: SimulatedDrive) -> None:
    table = truth_of(drive).table
    assert list(table) == list(COLUMNS)
    pd.testing.assert_frame_equal(table[["t", "satellite"]], keys(drive.log))
    assert drive.log.ranges is not None
    assert set(table) & set(drive.log.ranges) == {"t", "satellite"}


def test_parts_of_the_drive_have_parts_of_the_truth(drive: SimulatedDrive) -> None:
    some = truth_of(drive).table["satellite"].iloc[0]
    part = drive.log.between(10.0, 60.0).without_fixes_from(30.0, visible=(some,))
    found = truth_of(drive).of(part)
    pd.testing.assert_frame_equal(found.table[["t", "satellite"]], keys(part))
    whole = truth_of(drive).table.set_index(["t", "satellite"])
    same = found.table.set_index(["t", "satellite"])
    pd.testing.assert_frame_equal(same, whole.loc[same.index])
    assert found.column("clock").shape == (len(found.table),)


def test_it_knows_its_drive_without_latency(drive: SimulatedDrive) -> None:
    prompt = without_latency(drive.log)
    assert prompt.metadata.latency_removed
    found = truth_of(drive).of(prompt)
    pd.testing.assert_frame_equal(found.table[["t", "satellite"]], keys(prompt))
    expected = truth_of(drive).table.drop(columns="t")
    pd.testing.assert_frame_equal(found.table.drop(columns="t"), expected)


def test_another_drive_is_refused(drive: SimulatedDrive) -> None:
    ranges = drive.log.ranges
    assert ranges is not None
    other = replace(drive.log, ranges=ranges.assign(t=ranges["t"] + 0.05))
    with pytest.raises(LogError, match="another drive"):
        truth_of(drive).of(other)
    none = truth_of(drive).of(replace(drive.log, ranges=None))
    assert none.table.empty


def test_it_comes_back_and_goes_with_the_log(drive: SimulatedDrive, tmp_path: Path) -> None:
    folder = save_log(drive.log, tmp_path / "d", range_truth=drive.range_truth)
    pd.testing.assert_frame_equal(load_range_truth(folder).table, truth_of(drive).table)
    assert set(load_log(folder).tables()) == {"imu", "odometer", "fixes", "reference", "ranges"}
    with pytest.raises(OutputExistsError, match=RANGE_TRUTH):
        save_log(drive.log, folder)
    # A log that replaces it does not keep the truth of the one before.
    save_log(drive.log, folder, force=True)
    with pytest.raises(LogNotFoundError, match="no range_truth"):
        load_range_truth(folder)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ("t,satellite\n1,G01\n", "no column range_error"),
        (",".join(COLUMNS) + "\n" + ",".join(["1", "G01", *["x"] * 14]) + "\n", "not all numbers"),
        (",".join(COLUMNS) + "\n" + ",".join(["1", "G01", *[""] * 14]) + "\n", "not finite"),
    ],
)
def test_a_broken_file_says_what_is_wrong(tmp_path: Path, found: str, message: str) -> None:
    with gzip.open(tmp_path / RANGE_TRUTH, "wt") as file:
        file.write(found)
    with pytest.raises(LogError, match=message):
        load_range_truth(tmp_path)
