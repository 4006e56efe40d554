"""Fixes made of raw ranges: against truth, and without a look ahead."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import LogError
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.accuracy import errors_against
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.reading import read_log
from navlearn.logs.single_point_fixes import (
    ReceptionSolutions,
    SinglePointFixOptions,
    fixes_of,
    solve_receptions,
    with_single_point_fixes,
)
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions, find_satellites
from navlearn.logs.validate import validate_log

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("NAVLEARN_DATA", ROOT / ".." / "shared" / "data"))


@pytest.fixture(scope="module")
def drive() -> DriveLog:
    """A drive with ranges of two systems and no fixes."""
    options = SatelliteOptions(systems="GE")
    log = simulate_drive(duration=200.0, seed=11, imu_rate_hz=10.0, satellites=options).log
    return replace(log, fixes=log.fixes.iloc[:0])


def test_fixes_lie_on_the_truth_within_their_deviations(drive: DriveLog) -> None:
    log = with_single_point_fixes(drive)
    assert log.ranges is drive.ranges
    validate_log(log)
    assert len(log.fixes) == drive.ranges["t"].nunique()
    _, east, north, up = errors_against(log.fixes, drive.reference)
    for error, name in ((east, "std_e"), (north, "std_n"), (up, "std_u")):
        assert float(np.nanmean((error / log.fixes[name].to_numpy()) ** 2)) < 2.0
    assert float(np.nanmedian(np.hypot(east, north))) < 3.0
    for name in ("v_e", "v_n", "v_u"):
        truth = np.interp(log.fixes["t"], drive.reference["t"], drive.reference[name])
        assert float((log.fixes[name] - truth).abs().median()) < 0.1
    assert (log.fixes["satellites"] >= 6).all()


def test_no_fix_knows_of_a_later_reception(drive: DriveLog) -> None:
    whole = with_single_point_fixes(drive).fixes
    cut = with_single_point_fixes(drive.between(0.0, 60.0)).fixes
    pd.testing.assert_frame_equal(whole.iloc[: len(cut)], cut, rtol=1e-12)


def test_without_range_rates_there_are_no_velocities(drive: DriveLog) -> None:
    bare = replace(drive, ranges=drive.ranges.drop(columns=["range_rate", "std_rate"]))
    fixes = with_single_point_fixes(bare).fixes
    assert not {"v_e", "v_n", "v_u", "std_v"} & set(fixes)
    validate_log(bare.with_tables({"fixes": fixes}))


def test_receptions_of_too_few_satellites_give_no_fix(drive: DriveLog) -> None:
    ranges = drive.ranges
    few = ranges["satellite"].isin(sorted(ranges["satellite"].unique())[:3])
    inside = (ranges["t"] > 50.0) & (ranges["t"] < 80.0)
    log = with_single_point_fixes(replace(drive, ranges=ranges[few | ~inside]))
    t = log.fixes["t"]
    assert not ((t > 50.0) & (t < 80.0)).any()
    assert len(t) == drive.ranges["t"].nunique() - 29


def test_options_choose_satellites(drive: DriveLog) -> None:
    options = SinglePointFixOptions(
        ranges=RangeOptions(systems="G"), single_point=SinglePointOptions(elevation_mask=0.3)
    )
    found = solve_receptions(drive, options)
    assert found.series.systems == ("G",)
    assert found.points.clock.shape[-1] == 1
    low = found.series.ranges.elevation < 0.3
    assert not bool((found.points.used[low] > 0.0).any())


def test_refusals(drive: DriveLog) -> None:
    with pytest.raises(LogError, match="no raw ranges"):
        with_single_point_fixes(replace(drive, ranges=None))
    with pytest.raises(LogError, match="no raw ranges"):
        with_single_point_fixes(replace(drive, ranges=drive.ranges.iloc[:0]))
    three = sorted(drive.ranges["satellite"].unique())[:3]
    few = drive.ranges[drive.ranges["satellite"].isin(three)]
    with pytest.raises(LogError, match=r"none of .* receptions gave a position"):
        with_single_point_fixes(replace(drive, ranges=few))


@pytest.mark.parametrize(
    ("name", "folder", "median", "most", "share"),
    [
        ("kingston_2008", "kingston_2008", 1.3, 8.0, 0.98),
        ("smartloc", "smartloc_potsdamer", 35.0, 100.0, 0.95),
    ],
)
def test_real_drives(name: str, folder: str, median: float, most: float, share: float) -> None:
    """What is known of the data: 1 m in Kingston, tens of metres of street canyon in Berlin."""
    if not (DATA / folder).is_dir():
        pytest.skip(f"{folder} is not below {DATA}; set NAVLEARN_DATA to the folder of the logs")
    log = read_log(ROOT / "datasets" / f"{name}.yaml")
    fixes = with_single_point_fixes(log).fixes
    assert len(fixes) > share * log.ranges["t"].nunique()
    _, east, north, _ = errors_against(fixes, log.reference)
    error = np.hypot(east, north)
    assert float(np.nanmedian(error)) < median
    assert float(np.nanquantile(error, 0.95)) < most


@pytest.fixture(scope="module")
def town() -> tuple[DriveLog, ReceptionSolutions]:
    """A drive among houses, whose ranges err by more than is expected of them."""
    options = replace(find_satellites("urban"), systems=("G", "R", "E"), fixes="drawn")
    log = simulate_drive(duration=900.0, seed=13, imu_rate_hz=10.0, satellites=options).log
    return log, solve_receptions(log)


def test_larger_residuals_make_larger_deviations(
    town: tuple[DriveLog, ReceptionSolutions],
) -> None:
    """Written down one reception at a time."""
    found, fixes = town[1], fixes_of(town[1])
    for k, row in enumerate(np.flatnonzero(found.points.ok.numpy())):
        for solved, names in (
            (found.points, ("std_e", "std_n", "std_u")),
            (found.velocities, ("std_v",)),
        ):
            if not solved.ok[row]:
                continue
            test, degrees = float(solved.test[row]), int(solved.degrees[row])
            variance = solved.covariance[row].diagonal().numpy()
            if names == ("std_v",):
                variance = variance[:2].mean()
            expected = np.sqrt(max(1.0, test / degrees if degrees else 1.0) * variance)
            np.testing.assert_allclose(fixes.loc[k, list(names)].to_numpy(float), expected)


def test_deviations_are_more_honest_by_it(town: tuple[DriveLog, ReceptionSolutions]) -> None:
    log, found = town
    fixes = fixes_of(found)
    _, east, north, _ = errors_against(fixes, log.reference)
    plain = found.points.covariance[found.points.ok].diagonal(dim1=-2, dim2=-1).sqrt().numpy()
    off = np.hypot(east / fixes["std_e"], north / fixes["std_n"])
    beyond = np.mean(off > 2.448)
    before = np.mean(np.hypot(east / plain[:, 0], north / plain[:, 1]) > 2.448)
    assert before > 0.04
    assert beyond < 0.6 * before
    assert (fixes["std_e"].to_numpy() > plain[:, 0]).mean() < 0.5
