"""Drives that have ranges: cut, withheld, written, changed, as every other table."""

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.quality import check_log
from navlearn.logs.reading import read_log
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic.degrade import degrade_gyro
from navlearn.logs.validate import validate_log
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.outages.store import log_fingerprint


@pytest.mark.parametrize("table_format", ["csv", "parquet"])
def test_a_written_log_comes_back_exactly(tmp_path, make_log, range_table, broadcast, table_format):
    rng = np.random.default_rng(3)
    ranges = range_table().astype({"satellite": "str"})
    ranges["pseudorange"] += rng.standard_normal(30)
    ranges["range_rate"] = np.where(rng.uniform(size=30) < 0.3, np.nan, rng.standard_normal(30))
    log = validate_log(make_log(ranges=ranges, metadata=broadcast))
    again = load_log(save_log(log, tmp_path / "drive", table_format=table_format))
    pd.testing.assert_frame_equal(again.ranges, log.ranges, check_exact=True)
    assert again.metadata == broadcast
    assert read_log(tmp_path / "drive").metadata.klobuchar == broadcast.klobuchar


def test_parts_of_a_drive_keep_their_ranges(make_log, range_table, broadcast):
    log = validate_log(make_log(ranges=range_table(), metadata=broadcast))
    part = log.between(2.0, 5.0)
    assert part.ranges["t"].tolist() == np.repeat([2.0, 3.0, 4.0], 3).tolist()
    withheld = log.without_fixes_from(5.0, visible=("G30",))
    assert (withheld.ranges["t"] >= 5.0).sum() == 5
    assert set(withheld.ranges["satellite"][withheld.ranges["t"] >= 5.0]) == {"G30"}
    hidden = known_log(log, Outage(start=5.0, duration=3.0, satellites_visible=("R07",)))
    pd.testing.assert_frame_equal(hidden.ranges[hidden.ranges["t"] < 5.0], log.ranges[:15])
    assert set(hidden.ranges["satellite"][15:]) == {"R07"}


def test_whatever_goes_over_all_tables_copes_with_ranges(make_log, range_table, broadcast):
    log = validate_log(make_log(ranges=range_table(), metadata=broadcast))
    plain = make_log(metadata=broadcast)
    assert log_fingerprint(log) != log_fingerprint(plain)
    moved = log.with_tables({"ranges": log.ranges.assign(pseudorange=2.2e7)})
    assert log_fingerprint(log) != log_fingerprint(moved)
    mine, theirs = (riss_timeline(each, rate_hz=10.0) for each in (log, plain))
    assert all(bool((a == b).all()) for a, b in zip(mine.samples, theirs.samples, strict=True))
    assert len(imu_timeline(log).t) == len(imu_timeline(plain).t)
    report = check_log(log)
    assert not [f for f in report.findings if f.topic in ("time reversal", "duplicate stamps")]
    worse = degrade_gyro(log, "mems_l", seed=11)
    pd.testing.assert_frame_equal(worse.ranges, log.ranges)
