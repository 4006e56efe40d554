import numpy as np
import pandas as pd
import pytest

from navlearn.logs.clock import from_first_sample, without_backsteps, without_latency
from navlearn.logs.drive_log import LogMetadata


def test_time_starts_at_the_first_sample_of_any_table(make_log, tables):
    late = {name: table.assign(t=table["t"] + 152142.0) for name, table in tables.items()}
    late["imu"] = late["imu"].assign(t=late["imu"]["t"] + 1.09)
    log = from_first_sample(make_log(**late))
    assert log.fixes["t"].iloc[0] == 0.0
    assert log.imu["t"].iloc[0] == pytest.approx(1.09, abs=1e-9)
    assert log.metadata.time_origin == 152142.0
    assert from_first_sample(log) is log


def test_latency_is_removed_once(make_log, tables):
    known = LogMetadata(name="late", gnss_latency=0.25, odometer_latency=-0.1)
    log = without_latency(make_log(metadata=known))
    np.testing.assert_allclose(log.fixes["t"], tables["fixes"]["t"] - 0.25, atol=1e-12)
    np.testing.assert_allclose(log.odometer["t"], tables["odometer"]["t"] + 0.1, atol=1e-12)
    pd.testing.assert_frame_equal(log.imu, tables["imu"])
    assert log.metadata.latency_removed
    assert without_latency(log) is log


def test_without_known_latency_nothing_changes(make_log):
    log = make_log()
    assert without_latency(log) is log


def test_backsteps_go_until_time_is_past_its_maximum():
    table = pd.DataFrame({"t": [0.0, 1.0, 2.0, 1.5, 2.0, 2.5, 2.5, 3.0], "k": range(8)})
    assert without_backsteps(table)["k"].tolist() == [0, 1, 2, 5, 7]


def test_rows_without_time_stay_to_be_named():
    table = pd.DataFrame({"t": [0.0, np.nan, 1.0, 0.5]})
    assert len(without_backsteps(table)) == 3


def test_no_rows_are_no_problem():
    assert without_backsteps(pd.DataFrame({"t": np.zeros(0)})).empty


def test_part_of_a_drive(make_log):
    part = make_log().between(2.0, 5.0)
    assert part.imu["t"].iloc[[0, -1]].tolist() == [2.0, 4.9]
    assert part.fixes["t"].tolist() == [2.0, 3.0, 4.0]
