import math
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.descriptor import load_descriptor
from navlearn.logs.quality import check_log
from navlearn.logs.reading import read_log

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
START = 1_700_000_000
# The phone stands in portrait, looking at the driver: right x, forward −z, up y; then it is
# turned by 20° to the right and leans back.
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
YAW, PITCH = math.radians(20.0), math.radians(-7.0)
PHONE = Rotation.from_euler("ZXY", [-YAW, PITCH, 0.0]).as_matrix() @ UPRIGHT


def drive(rate_hz=10.0, duration=300.0):
    """Return the car's motion: time, speed, heading (anticlockwise from east), force and rate."""
    t = np.arange(0.0, duration, 1.0 / rate_hz)
    speed = 12.0 + 6.0 * np.sin(0.21 * t) * np.sin(0.05 * t)
    gain = np.gradient(speed, t)
    rate = 0.15 * np.sin(0.13 * t) + 0.1 * np.sin(0.37 * t + 1.0)
    heading = np.concatenate(([0.3], 0.3 + np.cumsum(rate)[:-1] / rate_hz))
    zero = np.zeros_like(t)
    force = np.stack((-speed * rate, gain, 9.8 + zero), axis=1)
    return t, speed, heading, force, np.stack((zero, zero, rate), axis=1)


def sensors(force, rate, sign=1.0):
    """Return what a phone reads of the car's vectors."""
    return sign * force @ PHONE, rate @ PHONE


def location(t, speed, heading):
    course = np.degrees(0.5 * np.pi - heading) % 360.0
    east = np.concatenate(([0.0], np.cumsum(speed * np.cos(heading))[:-1])) * (t[1] - t[0])
    return pd.DataFrame(
        {
            "bearingAccuracy": 1.5,
            "speedAccuracy": 0.2,
            "verticalAccuracy": 3.0,
            "horizontalAccuracy": 4.0,
            "speed": speed,
            "bearing": course,
            "altitude": 44.0,
            "longitude": -75.0 + east * 1.17e-5,
            "latitude": 40.0 + 0.0 * t,
        }
    )


def triad(names, values):
    return dict(zip(names, values.T, strict=True))


@pytest.fixture
def merged(tmp_path):
    """Write one file of all sensors: means over seconds that begin at their stamps."""

    def write(change=lambda frame: frame, **options):
        t, speed, heading, force, rate = drive(**options)
        acc, gyro = sensors(force, rate)
        means = [x.reshape(-1, 10, 3).mean(axis=1) for x in (acc, gyro)]
        each = location(t[5::10], speed[5::10], heading[5::10])
        whole = pd.to_datetime(START + np.arange(len(each)), unit="s", utc=True)
        frame = each.assign(
            time=whole.strftime("%Y-%m-%d %H:%M:%S+00:00"),
            **triad(("acc_x", "acc_y", "acc_z"), means[0]),
            **triad(("gyro_x", "gyro_y", "gyro_z"), means[1]),
        )
        path = tmp_path / "drive.csv.gz"
        change(frame).to_csv(path, index=False)
        return path

    return write


@pytest.fixture
def folder(tmp_path):
    """Write the app's folder."""

    def write(total=True, sign=1.0, **changed):
        t, speed, heading, force, rate = drive()
        acc, gyro = sensors(force, rate, sign)
        gravity = np.tile(sensors(np.array([[0.0, 0.0, 9.8]]), rate[:1], sign)[0], (t.size, 1))
        ns = (START + t) * 1e9
        tables = {"Gyroscope": (ns, gyro), "TotalAcceleration": (ns, acc)}
        if not total:
            del tables["TotalAcceleration"]
            tables |= {"Accelerometer": (ns, acc - gravity), "Gravity": (ns, gravity)}
        home = tmp_path / "phone"
        home.mkdir(exist_ok=True)
        for name, (stamps, values) in tables.items():
            frame = pd.DataFrame({"time": stamps.astype(np.int64), **triad("xyz", values)})
            frame.to_csv(home / f"{name}.csv", index=False)
        fixes = location(t[::10], speed[::10], heading[::10]).assign(time=ns[::10].astype(np.int64))
        changed.get("fixes", fixes).to_csv(home / "Location.csv", index=False)
        return home

    return write


def test_a_merged_file(merged):
    log = read_log(merged())
    assert log.metadata.interval_means == ("imu",)
    assert log.metadata.time_origin == START + 0.5
    # A mean ends a second after its stamp; a fix lies in the middle.
    np.testing.assert_allclose(log.imu["t"].iloc[:2], [0.5, 1.5])
    np.testing.assert_allclose(log.fixes["t"].iloc[:2], [0.0, 1.0])
    _, speed, heading, _, rate = drive()
    np.testing.assert_allclose(
        log.imu["gyro_z"], rate[:, 2].reshape(-1, 10).mean(axis=1), atol=2e-3
    )
    np.testing.assert_allclose(log.fixes["v_e"], (speed * np.cos(heading))[5::10], atol=1e-6)
    fix = log.fixes.iloc[0]
    assert fix[["std_e", "std_n", "std_u", "std_v"]].tolist() == [4.0, 4.0, 3.0, 0.2]
    assert (fix["lat"], fix["height"]) == pytest.approx((math.radians(40.0), 44.0))
    assert log.odometer.empty


@pytest.mark.parametrize("total", [True, False])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_apps_folder_and_the_mounting(folder, total, sign):
    log = read_log(folder(total=total, sign=sign))
    assert log.metadata.interval_means == ()
    found = log.metadata.extra["mounting"]
    assert found["axes"] == {"right": "x", "forward": "-z", "up": "y"}
    assert found["yaw_deg"] == pytest.approx(20.0, abs=1.0)
    assert found["pitch_deg"] == pytest.approx(-7.0, abs=0.5)
    assert found["yaw_std_deg"] < 2.0
    assert ("acceleration_sign" in log.metadata.extra) == (sign < 0.0)
    _, _, _, force, rate = drive()
    np.testing.assert_allclose(log.imu[["gyro_x", "gyro_y", "gyro_z"]], rate, atol=5e-3)
    np.testing.assert_allclose(log.imu[["accel_x", "accel_y", "accel_z"]], force, atol=0.3)


def test_the_found_mounting_may_be_stated(folder, tmp_path):
    home = folder(sign=-1.0)
    words = read_log(home).metadata.extra["mounting"]
    descriptor = tmp_path / "x.yaml"
    descriptor.write_text(
        "name: x\nformat: sensorlogger\npath: phone\n"
        "axes: {right: x, forward: -z, up: y}\n"
        f"mounting: {{pitch_deg: {words['pitch_deg']}, roll_deg: {words['roll_deg']}, "
        f"yaw_deg: {words['yaw_deg']}}}\n"
    )
    log = read_log(descriptor)
    assert "mounting" not in log.metadata.extra
    found = read_log(home)
    pd.testing.assert_frame_equal(log.imu, found.imu, atol=2e-3, rtol=0.0)


def parked(frame):
    return frame.assign(speed=0.0, bearing=0.0, bearingAccuracy=0.0)


def moved(frame):
    """Turn the phone about the vertical after half of the drive."""
    half = len(frame) // 2
    turn = Rotation.from_rotvec(math.radians(70.0) * PHONE[2]).as_matrix()
    for kind in ("acc", "gyro"):
        names = [f"{kind}_{axis}" for axis in "xyz"]
        values = frame[names].to_numpy()
        values = np.concatenate((values[:half], values[half:] @ turn.T))
        frame = frame.assign(**triad(names, values))
    return frame


@pytest.mark.parametrize("change", [parked, moved])
def test_an_unknown_yaw(merged, change):
    with pytest.warns(UserWarning, match=r"drive.csv.gz: how the phone is turned about the vert"):
        log = read_log(merged(change))
    assert list(log.imu) == ["t", "gyro_z", "accel_z"]
    assert log.metadata.extra["mounting"]["yaw_deg"] is None
    _, _, _, _, rate = drive()
    np.testing.assert_allclose(
        log.imu["gyro_z"], rate[:, 2].reshape(-1, 10).mean(axis=1), atol=5e-3
    )


def test_linear_acceleration_with_gravity_beside_and_rows_without_values(merged):
    down = PHONE[2] * 9.8

    def change(frame):
        names = ["acc_x", "acc_y", "acc_z"]
        linear = frame[names] - down
        frame = frame.assign(**linear, grav_x=down[0], grav_y=down[1], grav_z=down[2])
        frame.loc[40, ["gyro_x", "latitude", "longitude"]] = np.nan
        return frame

    log, plain = read_log(merged(change)), read_log(merged())
    assert len(log.imu) == len(plain.imu) - 1
    rest = plain.imu.drop(index=40).reset_index(drop=True)
    np.testing.assert_allclose(log.imu["accel_z"], rest["accel_z"], atol=0.02)


def test_velocities_that_are_not_known(folder):
    t, speed, heading, *_ = drive()
    fixes = location(t[::10], speed[::10], heading[::10]).assign(
        time=((START + t[::10]) * 1e9).astype(np.int64)
    )
    fixes.loc[0, ["speed", "bearing"]] = [-1.0, -1.0]
    fixes.loc[1, ["speed", "bearing", "bearingAccuracy"]] = [5.0, 0.0, 0.0]
    fixes.loc[2, ["speed", "bearing", "bearingAccuracy"]] = [0.0, -1.0, -1.0]
    fixes.loc[3, ["horizontalAccuracy", "speedAccuracy"]] = [-1.0, 0.0]
    found = read_log(folder(fixes=fixes)).fixes
    assert found["v_e"].isna().tolist()[:4] == [True, True, False, False]
    assert (found["v_e"][2], found["v_n"][2]) == (0.0, 0.0)
    assert found[["std_e", "std_v"]].isna().iloc[3].all()


def test_fixes_that_the_phone_had_in_store(folder):
    home = folder()
    fixes = pd.read_csv(home / "Location.csv")
    old, again = fixes.iloc[[0]].copy(), fixes.iloc[[7]]
    old["time"] -= 600 * 10**9
    pd.concat([old, fixes.iloc[:8], again, fixes.iloc[8:]]).to_csv(
        home / "Location.csv", index=False
    )
    log = read_log(home)
    assert len(log.fixes) == len(fixes)
    assert log.metadata.extra["stale_fixes"] == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.drop(columns=["acc_x", "acc_y", "acc_z"]), "drive.csv.gz: no acceleration"),
        (
            lambda f: f.assign(**(f[["acc_x", "acc_y", "acc_z"]] - PHONE[2] * 9.8)),
            r"mean acceleration of 0\.\d\d m/s² is without gravity, and there is no gravity",
        ),
        (lambda f: f.drop(columns="acc_y"), "no column acc_y; found"),
        (lambda f: f.assign(gyro_x=["a"] * len(f)), "column gyro_x holds 'a' at row 1, expected"),
        (lambda f: f.assign(time="soon"), "time is 'soon' at row 1, expected a time such as"),
    ],
)
def test_damaged_files(merged, change, message):
    with pytest.raises(LogError, match=message):
        read_log(merged(change))


def test_missing_files(folder, tmp_path):
    home = folder(total=False)
    (home / "Gravity.csv").unlink()
    with pytest.raises(LogError, match=r"Accelerometer.csv: mean acceleration of 0\.\d\d m/s² is"):
        read_log(home)
    (home / "Accelerometer.csv").unlink()
    with pytest.raises(LogError, match=r"Accelerometer.csv: no acceleration"):
        read_log(home)
    (home / "Location.csv").unlink()
    with pytest.raises(LogNotFoundError, match=r"Location.csv: no such file, which the app"):
        read_log(home, format="sensorlogger")
    other = tmp_path / "other.csv"
    other.write_text("a,b\n1,2\n")
    with pytest.raises(LogError, match="no known log format"):
        read_log(other)


@pytest.mark.parametrize(
    ("name", "csv"),
    [
        ("phone_2023_08_09", "2023-08-09_16-37-41"),
        ("phone_2025_03_01", "2025-03-01_15-04-26"),
        ("phone_2025_07_11", "2025-07-11_13-33-16"),
    ],
)
def test_published_drives_equal_their_csv(name, csv, data_folder):
    home = data_folder("phone_sensorlogger") / "csv" / csv
    path = DATASETS / f"{name}.yaml"
    log = read_log(path)
    descriptor, _ = load_descriptor(path)
    back = descriptor.body_from_sensor("RFU")
    imu = pd.read_csv(home / "imu.csv.gz").dropna(ignore_index=True)
    for kind, other, limit in (("gyro", "dev_gyro", 1e-6), ("accel", "dev_accel", 1e-4)):
        mine = log.imu[[f"{kind}_{axis}" for axis in "xyz"]].to_numpy() @ back
        theirs = imu[[f"{other}_{axis}" for axis in "xyz"]].to_numpy()
        assert np.abs(mine - theirs).max() < limit
    # Theirs lies along each second's gravity, mine along the mean one.
    assert np.corrcoef(log.imu["gyro_z"], imu["gyro_z"])[0, 1] > 0.998
    gnss = pd.read_csv(home / "gnss.csv.gz").dropna(subset=["lat"], ignore_index=True)
    assert len(gnss) == len(log.fixes)
    np.testing.assert_allclose(np.degrees(log.fixes["lat"]), gnss["lat"], atol=1e-8)
    for mine, theirs in (("v_e", "v_e"), ("v_n", "v_n"), ("std_e", "std_h"), ("height", "alt")):
        known = gnss[theirs].notna()
        difference = np.abs(log.fixes[mine] - gnss[theirs])[known]
        assert difference.max() < 6e-3, mine


def test_published_drive_as_its_descriptor_says(data_folder):
    """What the reader finds by itself is what the descriptor states, and turns agree."""
    raw = data_folder("phone_sensorlogger") / "raw" / "2025-07-11_13-33-16.csv.gz"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_log(raw).metadata.extra["mounting"]
    descriptor, _ = load_descriptor(DATASETS / "phone_2025_07_11.yaml")
    stated = descriptor.mounting
    assert found["axes"] == descriptor.axes.model_dump()
    for name in ("pitch_deg", "roll_deg", "yaw_deg"):
        assert found[name] == pytest.approx(getattr(stated, name), abs=0.2)
    report = check_log(read_log(DATASETS / "phone_2025_07_11.yaml"))
    assert report.ok
    assert report.figures["yaw_rate_correlation"] > 0.99
