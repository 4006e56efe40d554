import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.reading import read_log

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
N = 20
LAT, LON = math.radians(37.0), math.radians(-122.0)
EAST = np.array([-math.sin(LON), math.cos(LON), 0.0])
UP = np.array([math.cos(LAT) * math.cos(LON), math.cos(LAT) * math.sin(LON), math.sin(LAT)])
NORTH = np.cross(UP, EAST)


def quaternion(azimuth, pitch=0.0, roll=0.0):
    """Return the scalar-first quaternion of a forward-right-down case, by SciPy."""
    turn = Rotation.from_euler("ZYX", [azimuth, pitch, roll])  # of FRD in north, east, down
    earth = Rotation.from_matrix(np.stack([NORTH, EAST, -UP], axis=1))
    return (earth * turn).as_quat(scalar_first=True)


def arrays(start=500.0):
    """Return the arrays of a segment, by path."""
    t = start + np.arange(N) / 10.0
    triad = np.tile([1.0, 2.0, 3.0], (N, 1))
    fix = np.tile([37.0, -122.0, 10.0, 0.0, 30.0, 90.0], (N, 1))
    fix[:, 3] = 1.5e12 + 1e3 * np.round(t, 3)
    jitter = 0.01 * np.array([0, 1] * (N // 2))
    wheels = np.tile([9.0, 10.0, 11.0, 12.0], (N, 1))
    a = 6378137.0 / math.sqrt(1.0 - 6.69437999014e-3 * math.sin(LAT) ** 2)
    z = a * (1.0 - 6.69437999014e-3) * math.sin(LAT)
    place = np.array([a * math.cos(LAT) * math.cos(LON), a * math.cos(LAT) * math.sin(LON), z])
    log, pose = "processed_log", "global_pose"
    return {
        f"{log}/IMU/gyro/t": t,
        f"{log}/IMU/gyro/value": 0.01 * triad,
        f"{log}/IMU/accelerometer/t": t,
        f"{log}/IMU/accelerometer/value": triad - [0.0, 0.0, 12.8],
        f"{log}/CAN/wheel_speed/t": t,
        f"{log}/CAN/wheel_speed/value": wheels,
        f"{log}/CAN/speed/t": t,
        f"{log}/CAN/speed/value": wheels[:, :1],
        f"{log}/GNSS/live_gnss_ublox/t": t + 0.05 + jitter,
        f"{log}/GNSS/live_gnss_ublox/value": fix,
        f"{pose}/frame_times": t,
        f"{pose}/frame_positions": np.tile(place + 25.0 * UP, (N, 1)),
        f"{pose}/frame_velocities": np.tile(3.0 * EAST + 4.0 * NORTH - 0.5 * UP, (N, 1)),
        f"{pose}/frame_orientations": np.tile(quaternion(0.6, 0.05, -0.02), (N, 1)),
    }


@pytest.fixture
def segment(tmp_path):
    def write(number=7, route="b0|2018", start=500.0, **changed):
        home = tmp_path / "data" / route / str(number)
        for name, values in {**arrays(start), **changed}.items():
            path = home / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if values is None:
                continue
            if isinstance(values, bytes):
                path.write_bytes(values)
            else:
                with path.open("wb") as stream:
                    np.save(stream, values, allow_pickle=True)
        return home

    return write


def test_axes_units_and_places(segment):
    log = read_log(segment())
    row = log.imu.iloc[3]
    # Forward, right, down become right, forward, up.
    assert row[["gyro_x", "gyro_y", "gyro_z"]].tolist() == [0.02, 0.01, -0.03]
    assert row[["accel_x", "accel_y", "accel_z"]].tolist() == pytest.approx([2.0, 1.0, 9.8])
    assert log.metadata.time_origin == 500.0
    assert log.odometer["speed"].tolist() == [10.5] * N
    fix = log.fixes.iloc[0]
    assert (fix["lat"], fix["lon"], fix["height"]) == pytest.approx((LAT, LON, 30.0))
    assert (fix["v_e"], fix["v_n"]) == pytest.approx((10.0, 0.0))
    # The jitter of arrival is gone, its mean stays.
    np.testing.assert_allclose(np.diff(log.fixes["t"]), 0.1, atol=1e-3)
    assert log.fixes["t"].iloc[0] == pytest.approx(0.055, abs=0.006)
    truth = log.reference.iloc[5]
    assert (truth["lat"], truth["lon"]) == pytest.approx((LAT, LON), abs=1e-12)
    assert truth["height"] == pytest.approx(25.0, abs=1e-6)
    assert truth[["v_e", "v_n", "v_u"]].tolist() == pytest.approx([3.0, 4.0, -0.5])
    assert truth[["azimuth", "pitch", "roll"]].tolist() == pytest.approx([0.6, 0.05, -0.02])


def test_mounting_levels_imu_and_reference(segment, tmp_path):
    folder = segment(**{
        "processed_log/IMU/accelerometer/value": np.tile(
            [9.8 * math.sin(0.1), 0.0, -9.8 * math.cos(0.1)], (N, 1)
        ),
        "global_pose/frame_orientations": np.tile(quaternion(0.6, 0.1), (N, 1)),
    })  # fmt: skip
    path = tmp_path / "x.yaml"
    degrees = math.degrees(0.1)
    path.write_text(
        f"name: x\nformat: comma2k19\npath: '{folder}'\nmounting: {{pitch_deg: {degrees}}}\n"
    )
    log = read_log(path)
    np.testing.assert_allclose(log.imu[["accel_x", "accel_y"]], 0.0, atol=1e-9)
    np.testing.assert_allclose(log.reference["pitch"], 0.0, atol=1e-9)
    np.testing.assert_allclose(log.reference["azimuth"], 0.6, atol=1e-9)


def test_segments_of_a_route_make_one_drive(segment, tmp_path):
    for number in (9, 10):
        segment(number, start=500.0 + 2.0 * (number - 9))
    log = read_log(tmp_path / "data")
    assert log.metadata.extra["segments"] == ["9", "10"]
    assert log.duration == pytest.approx(3.9)
    assert len(log.fixes) == 2 * N
    segment(1, route="99|2018")
    with pytest.raises(LogError, match=r"2 routes below it"):
        read_log(tmp_path / "data")


def test_what_may_be_missing(segment):
    gone = {
        f"processed_log/{name}/{part}": None
        for name in ("CAN/wheel_speed", "GNSS/live_gnss_ublox")
        for part in ("t", "value")
    }
    pose = {name: None for name in arrays() if name.startswith("global_pose")}
    found = arrays()
    phone = {
        f"processed_log/GNSS/live_gnss_qcom/{part}":
            found[f"processed_log/GNSS/live_gnss_ublox/{part}"]
        for part in ("t", "value")
    }  # fmt: skip
    home = segment(**gone, **pose, **phone)
    for folder in ("processed_log/CAN/wheel_speed", "processed_log/GNSS/live_gnss_ublox"):
        (home / folder).rmdir()
    (home / "global_pose").rmdir()
    late = np.arange(N) / 10.0 + 500.03
    with (home / "processed_log/IMU/accelerometer/t").open("wb") as stream:
        np.save(stream, late)
    log = read_log(home)
    assert log.reference is None
    assert log.odometer["speed"].tolist() == [9.0] * N
    assert len(log.fixes) == N
    # Other times than the gyro's: interpolated to them, unknown outside.
    assert log.imu["accel_z"].isna().tolist() == [True] + [False] * (N - 1)


def test_missing_parts(segment, tmp_path):
    with pytest.raises(LogNotFoundError, match=r"value: no such array; found t"):
        read_log(segment(**{"processed_log/IMU/gyro/value": None}))
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogNotFoundError, match=r"no folder processed_log in or below it"):
        read_log(tmp_path / "empty", format="comma2k19")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.array([{"a": 1}] * N, dtype=object), "IMU/gyro/value: not readable as a NumPy array"),
        (b"\x93NUMPY\x01\x00v\x00{'descr'", "not readable as a NumPy array"),
        (b"", "not readable as a NumPy array"),
        (np.array(["a"] * N), "not readable as a NumPy array of numbers"),
        (np.zeros((N, 2)), r"found shape \(20, 2\), expected \(N, 3\)"),
        (np.float64(3.0), r"found shape \(\), expected"),
        (np.zeros((N - 1, 3)), "IMU/gyro: 20 times for 19 values"),
    ],
)
def test_damaged_arrays(segment, values, message):
    with pytest.raises(LogError, match=message):
        read_log(segment(**{"processed_log/IMU/gyro/value": values}))


def test_damage_that_leaves_an_array(segment):
    home = segment()
    path = home / "processed_log/IMU/gyro/value"
    path.write_bytes(path.read_bytes() + b"xx")
    with pytest.raises(LogError, match=r"IMU/gyro/value: 2 bytes beyond its array of \(20, 3\)"):
        read_log(home)
    fix = arrays()["processed_log/GNSS/live_gnss_ublox/value"]
    fix[3, 3] = 1e300
    with pytest.raises(LogError, match=r"fixes span 1e\+297 s of UTC and arrived within 1\.91 s"):
        read_log(segment(8, "other", **{"processed_log/GNSS/live_gnss_ublox/value": fix}))


def test_a_pickle_is_not_opened(segment):
    harm = b"cos\nsystem\n(S'touch harm'\ntR."
    with pytest.raises(LogError, match="not readable as a NumPy array"):
        read_log(segment(**{"processed_log/IMU/gyro/t": harm}))
    assert not Path("harm").exists()


def test_published_segment_equals_its_csv(data_folder):
    log = read_log(data_folder("comma2k19_example") / "raw")
    other = read_log(DATASETS / "comma2k19_example_csv.yaml")
    # Half a unit in the last place that the CSV prints.
    limits = {"lat": 1e-12, "lon": 1e-12, "azimuth": 1e-6, "pitch": 1e-6, "roll": 1e-6, "t": 1e-6}
    for name, table in other.tables().items():
        mine = log.tables()[name]
        assert len(mine) == len(table)
        for column in table:
            difference = np.nanmax(np.abs(mine[column] - table[column]))
            assert difference <= limits.get(column, 5.1e-5), (name, column)


def test_published_segment_is_levelled(data_folder):
    data_folder("comma2k19_example")
    reference = read_log(DATASETS / "comma2k19_example.yaml").reference
    slope = np.arctan2(reference["v_u"], np.hypot(reference["v_e"], reference["v_n"]))
    assert abs(np.degrees(np.median(reference["pitch"] - slope))) < 0.5
    course = np.arctan2(reference["v_e"], reference["v_n"])
    assert abs(np.degrees(np.median(np.sin(reference["azimuth"] - course)))) < 0.2
