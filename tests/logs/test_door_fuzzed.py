"""Whatever comes to the door is refused with advice or leaves as a sound log."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.errors import LogError, NavlearnError
from navlearn.logs.columns import REQUIRED
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.reading import read_log
from navlearn.logs.validate import validate_log

numbers = st.floats(allow_nan=True, allow_infinity=True, width=64) | st.floats(-3.0, 3.0)
cells = numbers | st.none() | st.text(max_size=3) | st.booleans() | st.integers(-5, 5)
names = st.sampled_from(["t", "gyro_z", "speed", "lat", "lon", "height", "v_e", "v_n", "x"])


@st.composite
def any_table(draw):
    rows = draw(st.integers(0, 6))
    columns = draw(st.lists(names, unique=True, max_size=6))
    kind = draw(st.sampled_from([numbers, cells]))
    table = {name: draw(st.lists(kind, min_size=rows, max_size=rows)) for name in columns}
    if draw(st.booleans()):
        table["t"] = list(np.arange(rows) * 0.5)
    return pd.DataFrame(table)


@settings(max_examples=150, deadline=None)
@given(any_table(), any_table(), any_table(), st.none() | any_table())
def test_any_tables(imu, odometer, fixes, reference):
    log = DriveLog(
        imu=imu,
        odometer=odometer,
        fixes=fixes,
        reference=reference,
        metadata=LogMetadata(name="any"),
    )
    try:
        sound = validate_log(log)
    except LogError as error:
        advice = str(error)
        if "any: " not in advice:
            pytest.fail(advice)
        return
    for name, table in sound.tables().items():
        assert (np.diff(table["t"]) > 0.0).all()
        if name in ("imu", "odometer"):
            assert np.isfinite(table[list(REQUIRED[name])].to_numpy()).all()


@settings(max_examples=120, deadline=None)
@given(
    name=st.sampled_from(["imu", "odometer", "fixes"]),
    column=st.integers(0, 9),
    row=st.integers(0, 9),
    value=st.floats(allow_nan=True, allow_infinity=True),
)
def test_any_single_change_of_a_sound_log(name, column, row, value):
    t = np.arange(10) * 0.5
    tables = {
        "imu": pd.DataFrame({"t": t, "gyro_z": 0.01, "accel_x": 0.1}),
        "odometer": pd.DataFrame({"t": t, "speed": 5.0}),
        "fixes": pd.DataFrame({"t": t, "lat": 0.7, "lon": 0.1, "v_e": 1.0, "v_n": 0.0}),
    }
    target = tables[name].columns[column % tables[name].shape[1]]
    tables[name].loc[row, target] = value
    log = DriveLog(**tables, reference=None, metadata=LogMetadata(name="any"))
    harmful = not np.isfinite(value) and (np.isinf(value) or target in ("t", *REQUIRED[name]))
    if target == "t" and np.isfinite(value):
        harmful = not (np.diff(tables[name]["t"]) > 0.0).all() or abs(value) > 1e11
    if target in ("lat", "lon", "speed") and np.isfinite(value):
        limit = {"lat": np.pi / 2, "lon": 2 * np.pi, "speed": 120.0}[target]
        harmful = abs(value) > limit + 1e-9
    if target == "gyro_z" and np.isfinite(value):
        # The 99th percentile of ten rows leans on the largest.
        harmful = np.quantile(np.abs(tables[name]["gyro_z"]), 0.99) > 3.5
    if not harmful:
        validate_log(log)
        return
    with pytest.raises(
        LogError, match=rf"any: {name}: .*{target if target != 't' else 'time|row'}"
    ):
        validate_log(log)


CORPUS = {
    "empty": "",
    "header only": "t,gyro_z\n",
    "one row": "t,gyro_z\n0,0\n",
    "no header": "0,0.01\n0.1,0.01\n0.2,0.01\n",
    "semicolons": "t;gyro_z\n0;0,01\n0,1;0,01\n",
    "ragged": "t,gyro_z\n0,0\n1,0,7,8\n2,0\n",
    "dates": "t,gyro_z\n2021-07-26T04:40:54,0\n2021-07-26T04:40:55,0\n",
    "binary": "\x00\x01\x02\x03\n\x00",
    "text": "all is well\n",
    "huge": "t,gyro_z\n0,1e999\n1,0\n",
    "quotes": 't,gyro_z\n"0,0\n1,0\n',
    "only spaces": "   \n   \n",
    "nan everywhere": "t,gyro_z\n,\n,\n",
}


@pytest.mark.parametrize("text", CORPUS.values(), ids=CORPUS.keys())
def test_a_corpus_of_spoilt_files(tmp_path, tables, text):
    for name, table in tables.items():
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    (tmp_path / "imu.csv").write_text(text)
    with pytest.raises(LogError, match=r"^imu\.csv: ..."):
        read_log(tmp_path)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=120))
def test_any_bytes_for_a_table(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("bytes")
    (folder / "odometer.csv").write_text("t,speed\n0,1\n1,1\n")
    (folder / "fixes.csv").write_text("t,lat,lon\n0,0.7,0.1\n1,0.7,0.1\n")
    (folder / "imu.csv").write_bytes(content)
    with pytest.raises(NavlearnError, match=r"imu\.csv"):
        read_log(folder)
