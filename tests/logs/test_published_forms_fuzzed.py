"""Bytes of published forms bent at random: a sound log, or a refusal with advice."""

import os
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navlearn.errors import NavlearnError
from navlearn.logs.formats.kitti import VALUES
from navlearn.logs.reading import read_log

N = 12


def kitti(home):
    (home / "oxts" / "data").mkdir(parents=True)
    for k in range(N):
        values = {**dict.fromkeys(VALUES, 0.01 * k), "lat": 49.0, "lon": 8.4, "az": 9.8}
        text = " ".join(f"{value:g}" for value in values.values())
        (home / "oxts" / "data" / f"{k:010d}.txt").write_text(text)
    stamps = [f"2011-09-30 12:00:00.{k:02d}0000000" for k in range(N)]
    (home / "oxts" / "timestamps.txt").write_text("\n".join(stamps))


def comma2k19(home):
    t = 10.0 + np.arange(N) / 10.0
    log = {
        "IMU/gyro": (t, 0.01 * np.ones((N, 3))),
        "IMU/accelerometer": (t, np.ones((N, 3))),
        "CAN/speed": (t, np.ones((N, 1))),
        "GNSS/live_gnss_ublox": (t, np.tile([37.0, -122.0, 1.0, 1e3, 9.0, 5.0], (N, 1))),
    }
    log["GNSS/live_gnss_ublox"][1][:, 3] += 1e3 * t
    for name, (times, values) in log.items():
        folder = home / "route" / "1" / "processed_log" / name
        folder.mkdir(parents=True)
        for part, array in (("t", times), ("value", values)):
            with (folder / part).open("wb") as stream:
                np.save(stream, array)


def sensorlogger(home):
    home.mkdir(parents=True)
    k = np.arange(N)
    frame = pd.DataFrame({"time": pd.to_datetime(1.7e9 + k, unit="s", utc=True).astype(str)})
    axes = {f"gyro_{axis}": 0.01 * k for axis in "xyz"}
    forces = {"acc_x": 0.1, "acc_y": 9.8, "acc_z": 0.2, "latitude": 40.0, "longitude": -75.0}
    frame.assign(**axes, **forces, speed=3.0, bearing=20.0).to_csv(home / "a.csv", index=False)


def nmea(home):
    pytest.importorskip("pynmeagps", reason="navlearn[gnss] is not installed")
    home.mkdir(parents=True)
    imu = pd.DataFrame({"t": 1772323190.0 + np.arange(N), "gyro_z": 0.01})
    imu.to_csv(home / "imu.csv", index=False)
    lines = []
    for k in range(N):
        for body in (
            f"GNRMC,0000{k:02d}.00,A,4906.6000,N,00824.3000,W,9.4,90.0,010326,,,A",
            f"GNGGA,0000{k:02d}.00,4906.6000,N,00824.3000,W,1,09,1.0,115.2,M,48.1,M,,",
        ):
            check = 0
            for letter in body:
                check ^= ord(letter)
            lines.append(f"${body}*{check:02X}")
    (home / "gnss.nmea").write_text("\r\n".join(lines))


FORMS = {"kitti": kitti, "comma2k19": comma2k19, "sensorlogger": sensorlogger, "nmea": nmea}


def read(home, form):
    with warnings.catch_warnings():
        # A phone that never moves: its yaw is not known, and the reader says so.
        warnings.filterwarnings("ignore", message=".*turned about the vertical is not known")
        return read_log(home / "a.csv" if form == "sensorlogger" else home)


@pytest.mark.parametrize("form", FORMS)
def test_what_is_bent_below_is_sound(form, tmp_path):
    FORMS[form](tmp_path / "log")
    log = read(tmp_path / "log", form)
    assert len(log.imu) == N


@pytest.mark.parametrize("form", FORMS)
@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_bent_bytes(form, data, tmp_path_factory):
    home = tmp_path_factory.mktemp(form) / "log"
    FORMS[form](home)
    files = sorted(path for path in home.rglob("*") if path.is_file())
    path = files[data.draw(st.integers(0, len(files) - 1))]
    content = bytearray(path.read_bytes())
    kind = data.draw(st.sampled_from(["cut", "flip", "insert", "remove"]))
    place = data.draw(st.integers(0, max(len(content) - 1, 0)))
    if kind == "remove":
        os.remove(path)
    else:
        if kind == "cut":
            del content[place:]
        elif kind == "flip":
            content[place] ^= data.draw(st.integers(1, 255))
        else:
            content[place:place] = data.draw(st.binary(max_size=8))
        path.write_bytes(bytes(content))
    try:
        log = read(home, form)
    except NavlearnError as error:
        if len(str(error)) < 20:
            pytest.fail(str(error))
        return
    for table in log.tables().values():
        assert (np.diff(table["t"]) > 0.0).all()
        assert not np.isinf(table.to_numpy()).any()
