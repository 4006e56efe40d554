"""The door of raw ranges, and what loops over all tables of a drive that has them."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navlearn.errors import ConfigError, LogError
from navlearn.logs.columns import REQUIRED
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.quality import check_log
from navlearn.logs.range_checks import checked_ranges
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.reading import read_log
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic.degrade import degrade_gyro
from navlearn.logs.validate import validate_log
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.outages.store import log_fingerprint

SKY = {"G02": (2.0e7, 1.2e7, 1.1e7), "G30": (-1e7, 2e7, 1.5e7), "R07": (1.4e7, -1.5e7, 1.5e7)}
BROADCAST = LogMetadata(
    name="small",
    range_corrections=("satellite_clock", "earth_rotation"),
    klobuchar=(1e-8, 1.5e-8, -6e-8, -1.2e-7, 8e4, 1e5, -6.6e4, -5.2e5),
    gps_time_origin=1485 * 604800.0 + 152142.25,
)


def table(times=range(10)):
    rows = [
        (float(t), name, 2.1e7 + 1e3 * k + t, *SKY[name], 45.0 - k)
        for t in times
        for k, name in enumerate(SKY)
    ]
    columns = ["t", "satellite", "pseudorange", "sat_x", "sat_y", "sat_z", "cn0"]
    return pd.DataFrame(rows, columns=columns)


def changed(row, column, value):
    frame = table()
    frame.loc[row, column] = value
    return frame


def test_a_sound_table_passes_as_it_is():
    pd.testing.assert_frame_equal(checked_ranges("ranges.csv", table()), table())
    assert checked_ranges("ranges.csv", table().iloc[:0]).empty


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (changed(4, "satellite", "G02"), None),
        (changed(5, "satellite", "G02"), "satellite G02 comes twice at 1 s, again in row 6"),
        (changed(2, "satellite", "X07"), r"satellite is 'X07' at row 3; expected the RINEX letter"),
        (changed(2, "satellite", "7"), "satellite is '7' at row 3"),
        (changed(2, "satellite", "G7"), "satellite is 'G7' at row 3; .*a number of two digits"),
        (changed(2, "satellite", "G00"), "satellite is 'G00' at row 3"),
        (changed(2, "satellite", "S120"), None),
        (changed(2, "satellite", None), "satellite is nan at row 3"),
        (changed(2, "satellite", "GPS 7"), "satellite is 'GPS 7' at row 3"),
        (changed(2, "pseudorange", np.nan), "pseudorange has no value at row 3 .satellite R07, 0"),
        (changed(2, "sat_y", np.nan), "column sat_y has no value at row 3"),
        (changed(2, "cn0", np.nan), None),
        (changed(6, "t", 0.5), r"time steps back at row 7 \(0.5 s after 1 s; 1 such rows\); sort"),
        (changed(6, "t", np.nan), "no time at row 7"),
        (changed(4, "sat_x", 0.0), None),
        (changed(4, ["sat_x", "sat_y", "sat_z"], 0.0), "G30 is 0 m .* orbit is not known"),
        (changed(4, "sat_x", 1e200), "satellite G30 is inf m from"),
        (changed(4, "sat_x", 9e7), "satellite G30 is 9.* m from the Earth's centre at row 5"),
        (changed(4, "pseudorange", 3e5), None),
    ],
)
def test_single_rows(frame, said):
    frame = frame.astype({"satellite": "str"})
    if said is None:
        name = frame["satellite"].iloc[4]
        if name == "G02":  # twice in one reception after all
            with pytest.raises(LogError, match="comes twice"):
                checked_ranges("ranges.csv", frame)
            return
        assert len(checked_ranges("ranges.csv", frame)) == 30
        return
    with pytest.raises(LogError, match=f"ranges.csv: .*{said}"):
        checked_ranges("ranges.csv", frame)


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [
        (["sat_x", "sat_y", "sat_z"], 1e-3, "in km: give unit: km .or scale: 1000. in a desc"),
        (["pseudorange"], 1e-3, "pseudorange is 2100.* in the median.*in km: give unit: km"),
        (["pseudorange"], 1.0 / 299792458.0, "in s: give scale: 299792458"),
        (["pseudorange"], 1e3, "give its unit in a descriptor"),
    ],
)
def test_other_units(columns, factor, said):
    frame = table()
    frame[columns] *= factor
    with pytest.raises(LogError, match=said):
        checked_ranges("ranges.csv", frame)


def test_a_week_that_ends():
    frame = table([604798, 604799, 0, 1])
    with pytest.raises(LogError, match="a week ended there: add 604800 s to what follows"):
        checked_ranges("ranges.csv", frame)


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"range_corrections": ("ionosfere",)}, r"'ionosfere' \(did you mean 'ionosphere'"),
        ({"klobuchar": (1.0, 2.0)}, "eight numbers, or none"),
        ({"klobuchar": (np.nan,) * 8}, "eight numbers, or none"),
        ({"gps_time_origin": -5.0}, "gps_time_origin is -5; expected GPS seconds"),
        ({"gps_time_origin": np.nan}, "gps_time_origin is nan"),
    ],
)
def test_what_cannot_be_known(make_log, known, said):
    with pytest.raises(LogError, match=said):
        validate_log(make_log(metadata=LogMetadata(name="small", **known)))


@st.composite
def any_ranges(draw):
    rows = draw(st.integers(0, 6))
    number = st.floats(allow_nan=True, allow_infinity=True) | st.floats(1e7, 4e7)
    text = st.sampled_from(["G01", "R2", "E333", "X01", "07", ""]) | st.text(max_size=4)
    frame = table()[:rows].astype({"satellite": object})
    for column in draw(st.lists(st.sampled_from(list(frame)), max_size=3)):
        cell = text if column == "satellite" else number
        frame[column] = draw(st.lists(cell | st.none(), min_size=rows, max_size=rows))
    return frame.drop(columns=draw(st.lists(st.sampled_from(list(frame)), max_size=1)))


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(any_ranges())
def test_any_table_of_ranges(small, frame):
    log = DriveLog(**small, ranges=frame, metadata=BROADCAST)
    try:
        sound = validate_log(log)
    except LogError as error:
        if "small: ranges: " not in str(error):
            pytest.fail(str(error))
        return
    found = sound.ranges
    assert (np.diff(found["t"]) >= 0.0).all()
    assert not found.duplicated(["t", "satellite"]).any()
    assert np.isfinite(found[["t", *REQUIRED["ranges"][1:]]].to_numpy()).all()
    series = ranges_of(sound, np.arange(11.0))
    assert all(part.isfinite().all() for part in series.ranges)


@pytest.fixture
def small(tables):
    return tables


@pytest.mark.parametrize("table_format", ["csv", "parquet"])
def test_a_written_log_comes_back_exactly(tmp_path, make_log, table_format):
    rng = np.random.default_rng(3)
    ranges = table().astype({"satellite": "str"})
    ranges["pseudorange"] += rng.standard_normal(30)
    ranges["range_rate"] = np.where(rng.uniform(size=30) < 0.3, np.nan, rng.standard_normal(30))
    log = validate_log(make_log(ranges=ranges, metadata=BROADCAST))
    again = load_log(save_log(log, tmp_path / "drive", table_format=table_format))
    pd.testing.assert_frame_equal(again.ranges, log.ranges, check_exact=True)
    assert again.metadata == BROADCAST
    assert read_log(tmp_path / "drive").metadata.klobuchar == BROADCAST.klobuchar


def write_csv(folder, small, **tables):
    for name, frame in {**small, **tables}.items():
        if frame is not None:
            frame.to_csv(folder / f"{name}.csv", index=False)


def test_a_folder_of_plain_tables(tmp_path, small):
    write_csv(tmp_path, small, ranges=table(), fixes=None, reference=None)
    log = read_log(tmp_path)
    assert log.ranges["satellite"].tolist() == list(SKY) * 10
    assert log.fixes.empty
    assert log.metadata.range_corrections == ()
    with pytest.raises(LogError, match="no column sat_clock, and range_corrections does not"):
        ranges_of(log, np.arange(11.0))
    numbered = table().assign(satellite=np.arange(30) % 3 + 1)
    write_csv(tmp_path, small, ranges=numbered)
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


def observed():
    frame = table()
    columns = {"pseudorange": "range_km", "sat_x": "x", "sat_y": "y", "sat_z": "z"}
    out = frame[list(columns)].rename(columns=columns) / 1e3
    out["ms"] = frame["t"] * 1e3
    out["system"], out["prn"] = frame["satellite"].str[0], frame["satellite"].str[1:].astype(int)
    return out


def test_a_descriptor_of_ranges(tmp_path, small):
    write_csv(tmp_path, small, obs=observed(), fixes=None)
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR)
    log = read_log(tmp_path / "mine.yaml")
    pd.testing.assert_frame_equal(log.ranges[list(table())[:6]], table().iloc[:, :6])
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
def test_wrong_descriptors_of_ranges(tmp_path, small, old, new, said):
    write_csv(tmp_path, small, obs=observed(), fixes=None)
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR.replace(old, new))
    with pytest.raises((LogError, ConfigError), match=said):
        read_log(tmp_path / "mine.yaml")


def test_repeats_are_dropped_where_the_descriptor_says_so(tmp_path, small):
    frame = observed()
    back = pd.concat([frame[:9], frame[3:]], ignore_index=True)
    write_csv(tmp_path, small, obs=back, fixes=None)
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR)
    with pytest.raises(LogError, match=r"time steps back at row 10.*on_backstep: drop"):
        read_log(tmp_path / "mine.yaml")
    (tmp_path / "mine.yaml").write_text(DESCRIPTOR + "on_backstep: drop\n")
    log = read_log(tmp_path / "mine.yaml")
    pd.testing.assert_frame_equal(log.ranges[list(table())[:6]], table().iloc[:, :6])


def test_parts_of_a_drive_keep_their_ranges(make_log):
    log = validate_log(make_log(ranges=table(), metadata=BROADCAST))
    part = log.between(2.0, 5.0)
    assert part.ranges["t"].tolist() == np.repeat([2.0, 3.0, 4.0], 3).tolist()
    withheld = log.without_fixes_from(5.0, visible=("G30",))
    assert (withheld.ranges["t"] >= 5.0).sum() == 5
    assert set(withheld.ranges["satellite"][withheld.ranges["t"] >= 5.0]) == {"G30"}
    hidden = known_log(log, Outage(start=5.0, duration=3.0, satellites_visible=("R07",)))
    pd.testing.assert_frame_equal(hidden.ranges[hidden.ranges["t"] < 5.0], log.ranges[:15])
    assert set(hidden.ranges["satellite"][15:]) == {"R07"}


def test_whatever_goes_over_all_tables_copes_with_ranges(make_log):
    log = validate_log(make_log(ranges=table(), metadata=BROADCAST))
    plain = make_log(metadata=BROADCAST)
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
