"""Ranges from plain tables and by descriptors."""

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.reading import read_log


@pytest.fixture
def write_csv(tmp_path, tables):
    """Write a small drive, some of its tables replaced, None left out."""

    def write(**changed):
        for name, frame in {**tables, **changed}.items():
            if frame is not None:
                frame.to_csv(tmp_path / f"{name}.csv", index=False)

    return write


def test_a_folder_of_plain_tables(tmp_path, write_csv, range_table):
    write_csv(ranges=range_table(), fixes=None, reference=None)
    log = read_log(tmp_path)
    assert log.ranges["satellite"].tolist() == ["G02", "G30", "R07"] * 10
    assert log.fixes.empty
    assert log.metadata.range_corrections == ()
    with pytest.raises(LogError, match="no column sat_clock, and range_corrections does not"):
        ranges_of(log, np.arange(11.0))
    numbered = range_table().assign(satellite=np.arange(30) % 3 + 1)
    write_csv(ranges=numbered)
    with pytest.raises(LogError, match=r"ranges.csv: column satellite holds numbers \(1\), which"):
        read_log(tmp_path)


DESCRIPTOR = """
name: mine
format: csv
path: .
tables:
  imu: {file: imu.csv}
  odometer: {file: odometer.csv}
  ranges:
    file: obs.csv
    time: {column: ms, unit: ms}
    satellite: {constellation: system, number: prn}
    columns:
      pseudorange: {column: range_km, unit: km}
      sat_x: {column: x, unit: km}
      sat_y: {column: y, unit: km}
      sat_z: {column: z, unit: km}
range_corrections: [satellite_clock, earth_rotation]
klobuchar: [1.0e-8, 0.0, 0.0, 0.0, 8.0e4, 0.0, 0.0, 0.0]
gps_time_origin: 898128000.0
"""


@pytest.fixture
def observed(range_table):
    """Ranges as the descriptor finds them: km, ms, and satellites in two columns."""
    frame = range_table()
    columns = {"pseudorange": "range_km", "sat_x": "x", "sat_y": "y", "sat_z": "z"}
    out = frame[list(columns)].rename(columns=columns) / 1e3
    out["ms"] = frame["t"] * 1e3
    out["system"], out["prn"] = frame["satellite"].str[0], frame["satellite"].str[1:].astype(int)
    return out


def test_a_descriptor_of_ranges(tmp_path, write_csv, range_table, observed):
    write_csv(obs=observed, fixes=None)
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR)
    log = read_log(tmp_path / "mine.yaml")
    pd.testing.assert_frame_equal(log.ranges[list(range_table())[:6]], range_table().iloc[:, :6])
    assert log.metadata.range_corrections == ("satellite_clock", "earth_rotation")
    assert log.metadata.gps_time_origin == 898128000.0
    assert len(log.metadata.klobuchar) == 8
    series = ranges_of(log, np.arange(11.0), near=(0.6, 0.5, 100.0))
    assert series.corrections["ionosphere"] == "klobuchar"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("number: prn", "number: nr", "no column nr.* which the descriptor names for satellite"),
        ("number: prn", "number: system", "column system holds 'G' at row 1, expected the number"),
        ("[satellite_clock", "[sat_clock", "range_corrections.0"),
        ("klobuchar: [1.0e-8, ", "klobuchar: [", "klobuchar: .* at least 8"),
        ("gps_time_origin: 8", "gps_time_origin: -8", "gps_time_origin"),
        ("{constellation: system", "{letter: system", "unknown key tables.ranges.satellite.letter"),
    ],
)
def test_wrong_descriptors_of_ranges(tmp_path, write_csv, observed, old, new, said):
    write_csv(obs=observed, fixes=None)
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR.replace(old, new))
    with pytest.raises((LogError, ConfigError), match=said):
        read_log(tmp_path / "mine.yaml")


def test_repeats_are_dropped_where_the_descriptor_says_so(
    tmp_path, write_csv, range_table, observed
):
    back = pd.concat([observed[:9], observed[3:]], ignore_index=True)
    write_csv(obs=back, fixes=None)
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR)
    with pytest.raises(LogError, match=r"time steps back at row 10.*on_backstep: drop"):
        read_log(tmp_path / "mine.yaml")
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR + "on_backstep: drop\n")
    log = read_log(tmp_path / "mine.yaml")
    pd.testing.assert_frame_equal(log.ranges[list(range_table())[:6]], range_table().iloc[:, :6])
