import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.errors import LogError, LogNotFoundError, NavlearnError, OutputExistsError
from navlearn.logs.drive_log import DriveLog, LogMetadata, StatedStart
from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.reading import read_log

METADATA = LogMetadata(
    name="drive",
    source="test",
    license="Apache-2.0",
    time_origin=152142.25,
    time_scale="GPS seconds of week 1485",
    lever_arm=(0.1, -0.2, 1.5),
    gnss_latency=0.1,
    latency_removed=True,
    interval_means=("imu",),
    sensors={"imu": "grade, °/s"},
    start=StatedStart(
        lat=0.7, lon=-1.3, height=60.0, v_e=1.0, v_n=2.0, v_u=0.1, azimuth=0.4, pitch=0.0, roll=0.01
    ),
    is_truth=True,
    extra={"seed": 3, "files": {"imu": "a.csv"}, "list": [1, 2.5]},
)


@pytest.mark.parametrize("table_format", ["csv", "parquet"])
def test_round_trip_is_exact(tmp_path, make_log, tables, table_format):
    rng = np.random.default_rng(11)
    wild = rng.standard_normal(101) * 10.0 ** rng.integers(-300, 300, 101)
    accel = np.where(rng.uniform(size=101) < 0.2, np.nan, wild)
    imu = tables["imu"].assign(gyro_z=rng.standard_normal(101) / 3.0, accel_x=accel)
    log = make_log(imu=imu, metadata=METADATA)
    again = load_log(save_log(log, tmp_path / "drive", table_format=table_format))
    for name, table in log.tables().items():
        pd.testing.assert_frame_equal(again.tables()[name], table, check_exact=True)
    assert again.metadata == METADATA


def test_without_reference(tmp_path, make_log):
    assert load_log(save_log(make_log(reference=None), tmp_path / "d")).reference is None


def test_the_same_log_gives_the_same_bytes(tmp_path, make_log):
    one, two = (save_log(make_log(), tmp_path / name) for name in ("one", "two"))
    for file in one.iterdir():
        assert file.read_bytes() == (two / file.name).read_bytes()


def test_nothing_is_overwritten_unless_forced(tmp_path, make_log):
    folder = save_log(make_log(), tmp_path / "d")
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(OutputExistsError, match=r"log.json, imu.csv.gz.*would be overwritten"):
        save_log(make_log(metadata=METADATA), folder)
    assert before == {file.name: file.read_bytes() for file in folder.iterdir()}
    save_log(make_log(metadata=METADATA), folder, force=True)
    assert load_log(folder).metadata.name == "drive"


def test_a_forced_log_leaves_no_table_of_the_old_one(tmp_path, make_log):
    folder = save_log(make_log(), tmp_path / "d")
    save_log(make_log(reference=None), folder, table_format="parquet", force=True)
    assert sorted(file.name for file in folder.iterdir()) == [
        "fixes.parquet",
        "imu.parquet",
        "log.json",
        "odometer.parquet",
    ]


def test_another_file_of_the_same_name_is_safe(tmp_path, make_log):
    (tmp_path / "imu.csv.gz").write_text("mine")
    with pytest.raises(OutputExistsError):
        save_log(make_log(), tmp_path)


def test_metadata_that_json_cannot_hold(tmp_path, make_log):
    strange = LogMetadata(name="x", extra={"what": {1, 2}})
    with pytest.raises(LogError, match="metadata cannot be written as JSON"):
        save_log(make_log(metadata=strange), tmp_path / "d")
    assert not (tmp_path / "d").exists()


def test_missing_parts(tmp_path, make_log):
    with pytest.raises(LogNotFoundError, match=r"no log\.json; found no such folder"):
        load_log(tmp_path / "nowhere")
    folder = save_log(make_log(), tmp_path / "d")
    (folder / "imu.csv.gz").unlink()
    with pytest.raises(LogNotFoundError, match=r"no imu.csv.gz, which log.json names; found fixes"):
        load_log(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"navlearn_log": 99}, "expected navlearn_log: 1"),
        ({"tables": []}, "no tables"),
        ({"tables": {"imu": "imu.csv.gz"}}, "tables has no fixes, odometer"),
        ({"tables": {"imu": 3, "odometer": "o", "fixes": "f"}}, "tables.imu"),
        ({"metadata": {"name": "x", "lisence": ""}}, r"unknown metadata lisence \(did you mean"),
        ({"metadata": {}}, "name"),
        ({"metadata": {"name": "x", "gnss_latency": "late"}}, "gnss_latency"),
        ({"metadata": {"name": "x", "lever_arm": [1, 2]}}, "lever_arm"),
    ],
)
def test_a_damaged_header(tmp_path, make_log, change, message):
    folder = save_log(make_log(), tmp_path / "d")
    header = json.loads((folder / "log.json").read_text())
    (folder / "log.json").write_text(json.dumps({**header, **change}))
    with pytest.raises(LogError, match=message):
        load_log(folder)


def test_a_truncated_header_or_table(tmp_path, make_log):
    folder = save_log(make_log(), tmp_path / "d")
    text = (folder / "log.json").read_text()
    (folder / "log.json").write_text(text[: len(text) // 2])
    with pytest.raises(LogError, match=r"log\.json: not readable as JSON"):
        load_log(folder)
    (folder / "log.json").write_text(text)
    whole = (folder / "imu.csv.gz").read_bytes()
    (folder / "imu.csv.gz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(LogError, match=r"imu.csv.gz: not readable as a table"):
        load_log(folder)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=20))
def test_any_float_survives(tmp_path_factory, values):
    size = len(values)
    t = np.arange(size) * 0.1
    log = DriveLog(
        imu=pd.DataFrame({"t": t, "gyro_z": 0.0, "accel_x": values}),
        odometer=pd.DataFrame({"t": t, "speed": 1.0}),
        fixes=pd.DataFrame({"t": t, "lat": 0.7, "lon": 0.1}),
        reference=None,
        metadata=LogMetadata(name="any"),
    )
    again = load_log(save_log(log, tmp_path_factory.mktemp("any") / "d"))
    np.testing.assert_array_equal(again.imu["accel_x"], values)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 255), st.sampled_from(["log.json", "imu.csv.gz"]))
def test_any_changed_byte_gives_a_log_or_a_refusal(tmp_path_factory, place, byte, name):
    t = np.arange(5) * 0.1
    log = DriveLog(
        imu=pd.DataFrame({"t": t, "gyro_z": 0.0}),
        odometer=pd.DataFrame({"t": t, "speed": 1.0}),
        fixes=pd.DataFrame({"t": t, "lat": 0.7, "lon": 0.1}),
        reference=None,
        metadata=LogMetadata(name="any"),
    )
    folder = save_log(log, tmp_path_factory.mktemp("any") / "d")
    content = bytearray((folder / name).read_bytes())
    content[place % len(content)] = byte
    (folder / name).write_bytes(bytes(content))
    try:
        read_log(folder)
    except NavlearnError:
        return
