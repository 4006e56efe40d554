import gzip

import numpy as np
import pandas as pd
import pytest
import yaml

from navlearn.errors import ConfigError, LogError, LogNotFoundError, MissingExtraError
from navlearn.logs.reading import read_log


def write(folder, tables, ending=".csv"):
    folder.mkdir(exist_ok=True)
    for name, table in tables.items():
        if ending == ".parquet":
            table.to_parquet(folder / f"{name}.parquet", index=False)
        else:
            table.to_csv(folder / f"{name}{ending}", index=False)
    return folder


def described(tmp_path, **entries):
    path = tmp_path / "log.yaml"
    start = {"name": "x", "format": "csv", "path": "log"}
    path.write_text(yaml.safe_dump({**start, **entries}), encoding="utf-8")
    return path


@pytest.mark.parametrize("ending", [".csv", ".csv.gz", ".parquet"])
def test_canonical_tables_come_back_exactly(tmp_path, tables, ending):
    log = read_log(write(tmp_path / "log", tables, ending))
    for name, table in tables.items():
        pd.testing.assert_frame_equal(log.tables()[name], table, check_exact=True)
    assert log.metadata.name == "log"


def test_suffixes_tell_units(tmp_path, tables):
    raw = {
        "imu": tables["imu"].assign(gyro_z=np.degrees(tables["imu"]["gyro_z"])),
        "odometer": tables["odometer"].assign(speed=tables["odometer"]["speed"] * 3.6),
        "gnss": tables["fixes"].assign(lat=np.degrees(tables["fixes"]["lat"])),
    }
    raw["imu"] = raw["imu"].rename(columns={"gyro_z": "gyro_z_deg_per_s"})
    raw["odometer"] = raw["odometer"].rename(columns={"speed": "speed_kmh"})
    raw["gnss"] = raw["gnss"].rename(columns={"lat": "lat_deg"})
    log = read_log(write(tmp_path / "log", raw))
    np.testing.assert_allclose(log.imu["gyro_z"], tables["imu"]["gyro_z"], rtol=1e-14)
    np.testing.assert_allclose(log.odometer["speed"], tables["odometer"]["speed"], rtol=1e-14)
    np.testing.assert_allclose(log.fixes["lat"], tables["fixes"]["lat"], rtol=1e-14)


def test_a_column_there_twice(tmp_path, tables):
    raw = {**tables, "odometer": tables["odometer"].assign(speed_kmh=1.0)}
    with pytest.raises(LogError, match=r"odometer.csv: speed is there twice, also as speed_kmh"):
        read_log(write(tmp_path / "log", raw))


def test_time_from_an_epoch_in_milliseconds(tmp_path, tables):
    raw = {
        name: table.assign(t_ms=np.rint(1e3 * table["t"]) + 1_700_000_000_000).drop(columns="t")
        for name, table in tables.items()
    }
    log = read_log(write(tmp_path / "log", raw))
    np.testing.assert_allclose(log.imu["t"], tables["imu"]["t"], atol=1e-6)
    assert log.metadata.time_origin == pytest.approx(1.7e9)


def test_a_full_descriptor(tmp_path, tables):
    imu, fixes = tables["imu"], tables["fixes"]
    folder = tmp_path / "log"
    folder.mkdir()
    # Forward-right-down, degrees and g, one file for all, speed and course, heights over the sea.
    sensors = pd.DataFrame({"stamp": 100.0 + 1e3 * imu["t"], "wz": -np.degrees(imu["gyro_z"])})
    sensors = sensors.assign(ax=imu["accel_y"] / 9.80665, ay=imu["accel_x"] / 9.80665)
    sensors.to_csv(folder / "sensors.csv", index=False)
    tables["odometer"].assign(t=0.1 + tables["odometer"]["t"]).to_csv(folder / "v.csv", index=False)
    receiver = pd.DataFrame({"time": fixes["t"] + 0.1, "phi": np.degrees(fixes["lat"])})
    receiver = receiver.assign(lam=np.degrees(fixes["lon"]), h=fixes["height"] - 30.0)
    receiver = receiver.assign(v=36.0, heading=180.0 - 90.0)
    receiver.to_csv(folder / "gps.csv", index=False)
    path = described(
        tmp_path,
        license="CC0",
        axes="FRD",
        geoid_height=30.0,
        gnss_latency=0.2,
        lever_arm=[0.1, 0.2, 1.3],
        sensors={"imu": "toy"},
        tables={
            "imu": {
                "file": "sensors.csv",
                "time": {"column": "stamp", "unit": "ms"},
                "columns": {
                    "gyro_z": {"column": "wz", "unit": "deg/s"},
                    "accel_x": {"column": "ax", "unit": "g"},
                    "accel_y": {"column": "ay", "unit": "g"},
                },
            },
            "odometer": {"file": "v.csv", "columns": {"speed": "speed"}},
            "fixes": {
                "file": "gps.csv",
                "time": {"column": "time"},
                "columns": {
                    "lat": {"column": "phi", "unit": "deg"},
                    "lon": {"column": "lam", "unit": "deg"},
                    "height": "h",
                },
                "velocity": {
                    "speed": {"column": "v", "unit": "km/h"},
                    "course": {"column": "heading", "unit": "deg", "scale": -1.0, "offset": 3.2},
                },
            },
        },
    )
    log = read_log(path)
    # The fixes, 0.2 s late, turn out to be the first samples.
    assert log.metadata.time_origin == pytest.approx(-0.1)
    np.testing.assert_allclose(log.imu["t"], imu["t"] + 0.2, atol=1e-9)
    np.testing.assert_allclose(log.fixes["t"], fixes["t"], atol=1e-9)
    for name in ("gyro_z", "accel_x", "accel_y"):
        np.testing.assert_allclose(log.imu[name], imu[name], atol=1e-12)
    np.testing.assert_allclose(log.fixes["lat"], fixes["lat"], rtol=1e-14)
    np.testing.assert_allclose(log.fixes["height"], 80.0)
    course = 3.2 - np.pi / 2
    np.testing.assert_allclose(log.fixes["v_e"], 10.0 * np.sin(course))
    np.testing.assert_allclose(log.fixes["v_n"], 10.0 * np.cos(course))
    assert log.metadata.lever_arm == (0.1, 0.2, 1.3)
    assert log.metadata.latency_removed
    assert (log.metadata.license, dict(log.metadata.sensors)) == ("CC0", {"imu": "toy"})


def test_backsteps_are_dropped_where_the_descriptor_says_so(tmp_path, tables):
    imu = tables["imu"].copy()
    imu.loc[50, "t"] = 1.0
    write(tmp_path / "log", {**tables, "imu": imu})
    with pytest.raises(LogError, match=r"imu.csv: time steps back at row 51 .*on_backstep: drop"):
        read_log(tmp_path / "log")
    assert len(read_log(described(tmp_path, on_backstep="drop")).imu) == 100


def test_epochs_replace_jittery_arrivals(tmp_path, tables):
    jitter = np.abs(np.random.default_rng(7).standard_normal(11)) * 0.01
    fixes = tables["fixes"].assign(t=tables["fixes"]["t"] + jitter, utc=1.6e9 + np.arange(11.0))
    write(tmp_path / "log", {**tables, "fixes": fixes})
    columns = {"lat": "lat", "lon": "lon"}
    layout = {"file": "fixes.csv", "epoch": {"column": "utc"}, "columns": columns}
    rest = {name: {"file": f"{name}.csv"} for name in ("imu", "odometer")}
    log = read_log(described(tmp_path, tables={**rest, "fixes": layout}))
    assert np.ptp(np.diff(log.fixes["t"])) < 1e-6
    assert np.ptp(np.diff(fixes["t"])) > 5e-3


def test_rows_without_a_fix_are_left_out(tmp_path, tables):
    fixes = tables["fixes"].copy()
    fixes.loc[:2, ["lat", "lon", "v_e", "v_n"]] = np.nan
    assert len(read_log(write(tmp_path / "log", {**tables, "fixes": fixes})).fixes) == 8
    fixes.loc[:, ["lat", "lon", "v_e", "v_n"]] = np.nan
    with pytest.raises(LogError, match=r"fixes\.csv: none of its 11 rows holds a position"):
        read_log(write(tmp_path / "log", {**tables, "fixes": fixes}))


def test_a_missing_table(tmp_path, tables):
    del tables["fixes"], tables["reference"]
    message = r"no table fixes \(looked for fixes.csv or.*gnss.csv"
    with pytest.raises(LogNotFoundError, match=message):
        read_log(write(tmp_path / "log", tables))


def test_a_car_without_odometer_and_a_reference_without_fixes(tmp_path, tables):
    none = {name: tables[name] for name in ("imu", "reference")}
    log = read_log(write(tmp_path / "log", none))
    assert list(log.odometer) == ["t", "speed"]
    assert len(log.odometer) == len(log.fixes) == 0
    tables["odometer"].iloc[:0].to_csv(tmp_path / "log" / "odometer.csv", index=False)
    with pytest.raises(LogError, match=r"odometer.csv: found 0 rows"):
        read_log(tmp_path / "log")
    (tmp_path / "log" / "odometer.csv").unlink()
    (tmp_path / "log" / "reference.csv").unlink()
    layout = {"imu": {"file": "imu.csv"}}
    with pytest.raises(LogError, match=r"no table fixes, ranges or reference"):
        read_log(described(tmp_path, tables=layout))


def test_a_missing_file_of_a_descriptor(tmp_path, tables):
    write(tmp_path / "log", tables)
    with pytest.raises(
        LogNotFoundError, match=r"gps.csv: no such file; the folder holds fixes.csv"
    ):
        read_log(described(tmp_path, tables={"fixes": {"file": "gps.csv"}}))


def test_a_descriptor_without_a_needed_table(tmp_path, tables):
    write(tmp_path / "log", tables)
    with pytest.raises(LogError, match=r"no table imu, which every drive log needs \(found: fixes"):
        read_log(described(tmp_path, tables={"fixes": {"file": "fixes.csv"}}))


@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        ({"speed": "sped"}, LogError, r"no column sped \(did you mean 'speed'\?\).*for speed"),
        ({"spead": "speed"}, ConfigError, r"spead is no column of odometer \(did you mean 'speed'"),
        ({"speed": {"column": "speed", "unit": "kph"}}, ConfigError, "'kph' is no unit of speed"),
    ],
)
def test_wrong_columns_of_a_descriptor(tmp_path, tables, columns, error, message):
    write(tmp_path / "log", tables)
    layout = {name: {"file": f"{name}.csv"} for name in tables}
    layout["odometer"]["columns"] = columns
    with pytest.raises(error, match=message):
        read_log(described(tmp_path, tables=layout))


def test_text_among_scaled_numbers(tmp_path, tables):
    odometer = tables["odometer"].rename(columns={"speed": "speed_kmh"}).astype(object)
    odometer.loc[4, "speed_kmh"] = "n/k"
    with pytest.raises(LogError, match="speed_kmh holds 'n/k' at row 5, expected numbers"):
        read_log(write(tmp_path / "log", {**tables, "odometer": odometer}))


def test_empty_and_truncated_files(tmp_path, tables):
    folder = write(tmp_path / "log", tables)
    (folder / "odometer.csv").write_text("")
    with pytest.raises(LogError, match=r"odometer\.csv: the file is empty"):
        read_log(folder)
    (folder / "odometer.csv").unlink()
    whole = gzip.compress(tables["odometer"].to_csv(index=False).encode())
    (folder / "odometer.csv.gz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(LogError, match=r"odometer.csv.gz: not readable as a table"):
        read_log(folder)


def test_parquet_without_pyarrow(tmp_path, tables, monkeypatch):
    folder = write(tmp_path / "log", tables, ".parquet")

    def refuse(*_, **__):
        raise ImportError("no pyarrow")

    monkeypatch.setattr(pd, "read_parquet", refuse)
    with pytest.raises(MissingExtraError, match=r"pip install navlearn\[parquet\]"):
        read_log(folder)
