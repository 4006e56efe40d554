"""Ranges along a reference, beside those that the simulator makes of the motion itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.reading import read_log
from navlearn.logs.synthetic import PRESETS, simulate_drive, with_simulated_ranges
from navlearn.logs.synthetic.semi_real_ranges import _course
from navlearn.logs.validate import validate_log

DATASETS = Path(__file__).resolve().parents[3] / "datasets"
ARM = (0.4, -1.1, 1.5)
SKY = replace(PRESETS["urban"], multipath=0.0, reflection_rate=0.0)


@pytest.fixture(scope="module")
def made() -> DriveLog:
    return simulate_drive(
        profile="town", grade="ideal", duration=150.0, seed=11, imu_rate_hz=10.0, lever_arm=ARM,
        satellites=SKY, standstill=5.0,
    ).log  # fmt: skip


def ranges_of(log: DriveLog) -> pd.DataFrame:
    assert log.ranges is not None
    return log.ranges


def test_it_is_what_the_simulator_makes(made: DriveLog) -> None:
    bare = replace(made, ranges=None, metadata=replace(made.metadata, gps_time_origin=None))
    found = with_simulated_ranges(bare, SKY, seed=11)
    keys = ["t", "satellite"]
    both = ranges_of(found.log).merge(ranges_of(made), on=keys, suffixes=("", "_"))
    # Streets end at a distance driven, which sums differ in: a second sooner or later.
    assert len(both) > 0.98 * len(ranges_of(made))
    apart = (both["pseudorange"] - both["pseudorange_"]).abs()
    assert apart.quantile(0.98) < 0.01
    assert (both["range_rate"] - both["range_rate_"]).abs().quantile(0.98) < 0.02
    validate_log(found.log)
    pd.testing.assert_frame_equal(found.truth.of(found.log).table[keys], ranges_of(found.log)[keys])


def test_it_says_what_was_done_and_leaves_the_rest(made: DriveLog) -> None:
    found = with_simulated_ranges(made, replace(SKY, fixes="drawn"), seed=5).log
    about = found.metadata
    assert about.name == f"{made.metadata.name}_ranges_5"
    assert "semi-synthetic" in about.sensors["ranges"]
    # The log's own time, whatever the seed.
    assert about.gps_time_origin == made.metadata.gps_time_origin
    for name, table in found.tables().items():
        if name != "ranges":
            pd.testing.assert_frame_equal(table, made.tables()[name])
    solved = with_simulated_ranges(made, SKY, seed=5).log
    assert "semi-synthetic" in solved.metadata.sensors["fixes"]
    assert not solved.fixes.equals(made.fixes)


def test_a_recorded_drive_in_canonical_form() -> None:
    log = read_log(DATASETS / "sample_drive.yaml").between(0.0, 300.0)
    found = with_simulated_ranges(log, "suburban", seed=2, rate_hz=2.0).log
    t = np.unique(ranges_of(found)["t"])
    np.testing.assert_allclose(np.diff(t), 0.5)
    assert t[-1] == pytest.approx(299.0)
    assert len(found.fixes) > 0.95 * t.size


def test_where_the_reference_pauses_nothing_is_received(made: DriveLog) -> None:
    assert made.reference is not None
    known = made.reference
    paused = replace(made, reference=known[(known["t"] < 60.0) | (known["t"] > 75.0)])
    t = ranges_of(with_simulated_ranges(paused, SKY, seed=11).log)["t"]
    assert not t.between(60.5, 74.5).any()
    assert {55.0, 80.0} <= set(t)


def test_a_reference_without_heights_or_azimuth_serves(made: DriveLog) -> None:
    assert made.reference is not None
    flat = made.reference.drop(columns=["height", "v_u", "azimuth", "pitch", "roll"])
    about = replace(made.metadata, lever_arm=(0.0, 0.0, 0.0))
    found = with_simulated_ranges(replace(made, reference=flat, metadata=about), SKY, seed=11).log
    assert found.fixes["height"].abs().median() < 20.0
    with pytest.raises(LogError, match="ranges are made from with a lever arm"):
        with_simulated_ranges(replace(made, reference=flat), SKY, seed=11)


def test_a_standing_car_looks_where_it_last_went() -> None:
    v_e = np.array((0.0, 0.1, 5.0, 5.0, 0.2, np.nan, 0.0, 0.0))
    v_n = np.array((0.0, 0.0, 0.0, 5.0, -0.2, np.nan, -4.0, 0.1))
    found = np.degrees(_course(v_e, v_n, np.hypot(v_e, v_n)))
    np.testing.assert_allclose(found, [90, 90, 90, 45, 45, 45, 180, 180])
    assert not _course(v_e[:2], v_n[:2], np.hypot(v_e, v_n)[:2]).any()


def test_refusals(made: DriveLog) -> None:
    with pytest.raises(LogError, match="no reference"):
        with_simulated_ranges(replace(made, reference=None), SKY)
    with pytest.raises(ConfigError, match="seed: found -1"):
        with_simulated_ranges(made, SKY, seed=-1)
    with pytest.raises(ConfigError, match="rate_hz: found 0"):
        with_simulated_ranges(made, SKY, rate_hz=0.0)
    with pytest.raises(ConfigError, match="expected one of open_sky"):
        with_simulated_ranges(made, "downtown")
