"""Bytes of published forms bent at random: a sound log, or a refusal with advice."""

import os
import warnings

import numpy as np
import pandas as pd
import pytest
import scipy.io
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


def smartloc(home):
    home.mkdir(parents=True)
    odometry, ranges, truth = [], [], []
    for k in range(N):
        odometry.append(f"odom3 {0.2 * k:g} 5 0 0 0 0 -0.01 1 1 1 1 1 1")
        for number, system in ((12, 1), (301, 4)):
            ranges.append(f"range3 {0.2 * k:g} 2.1e7 25 2e7 1.1e7 1.2e7 {number} {system} 60 45")
        truth.append(f"point3 {0.2 * k:g} 3785108 899901 5037234" + 9 * " 0")
    (home / "A_Input.txt").write_text("\n".join(odometry + ranges))
    (home / "A_GT.txt").write_text("\n".join(truth))


def cell_row(values):
    cells = np.empty((1, N), dtype=object)
    for k in range(N):
        cells[0, k] = np.array([[float(value)] for value in values])
    return cells


def navinst(home):
    (home / "Mat").mkdir(parents=True)
    second, week = np.arange(N)[None, :], np.full((1, N), 1485)
    one, axes = np.ones((1, N)), "XYZ"
    raw = {name: [1.0, 2.0] for name in ("Rho_GPS_std", "Dopp_GPS", "Sat_Ion_Corr", "Sat_Tro_Corr")}
    raw |= {f"Sat_V{axis}": [1e3, 2e3] for axis in axes} | {"Sat_Clk_Corr": [5e3, 6e3]}
    raw |= {f"Sat_{axis}": [1.5e7, -1.6e7] for axis in axes} | {"Sat_Num": [3, 4]}
    raw["Rho_GPS"] = [2.1e7, 2.2e7]
    imu = {"IMU_second": second, "w": dict.fromkeys("xyz", one), "f": dict.fromkeys("xyz", one)}
    ranges = {name: cell_row(values) for name, values in raw.items()}
    receiver = {"sv_no": cell_row([4, 3]), "c_2_n_L1": cell_row([40, 41])}
    files = {
        "f_w_IMSseconds_dt.mat": imu,
        "CarChip_Speed_interpolated.mat": {"CarChip_second_1HZ": second, "CarChip_Speed_1HZ": one},
        "BESTGPSPOS.mat": {"BGP_second": second}
        | {f"BGP_{name}{end}": one for name in ("Lat", "Long", "Alt") for end in ("", "_std")},
        "Raw_Data_combined.mat": {"RAW_second": second, "RAW_week": week, **ranges},
        "GPS_Data_Combined_Nova.mat": {"GPS_sec": second, "GPS_week": week, **receiver},
        "IONUTC.mat": {f"{letter}{power}": one for letter in "ab" for power in range(4)},
    }
    for name, variables in files.items():
        scipy.io.savemat(home / "Mat" / name, variables)


FORMS = {
    "kitti": kitti,
    "comma2k19": comma2k19,
    "sensorlogger": sensorlogger,
    "nmea": nmea,
    "smartloc": smartloc,
    "navinst": navinst,
}


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
    # SciPy itself does not survive every changed byte of a MATLAB file that is not compressed
    kinds = ["cut", "remove"] if form == "navinst" else ["cut", "flip", "insert", "remove"]
    kind = data.draw(st.sampled_from(kinds))
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
    for name, table in log.tables().items():
        step = np.diff(table["t"])
        assert (step >= 0.0 if name == "ranges" else step > 0.0).all()
        assert not np.isinf(table.select_dtypes("number").to_numpy()).any()
