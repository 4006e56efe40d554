import math
from pathlib import Path

import numpy as np
import pytest
import torch

from navlearn.errors import LogError, LogNotFoundError
from navlearn.frames import enu_between
from navlearn.logs.formats.kitti import VALUES
from navlearn.logs.quality import check_log
from navlearn.logs.reading import read_log
from navlearn.logs.reference import reference_at

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
DRIVES = ("0018", "0020", "0027", "0028", "0033", "0034", "0042")


def sample(**changes):
    """Return one sample's text: 30 numbers, zero unless stated."""
    values = {**dict.fromkeys(VALUES, 0.0), "lat": 49.0, "lon": 8.4, "alt": 115.0, "az": 9.8}
    return " ".join(f"{value:.15g}" for value in {**values, **changes}.values())


@pytest.fixture
def drive(tmp_path):
    """Write ten samples of a drive, some changed: text by number, None to leave it out."""

    def write(samples=None, stamps=None):
        oxts = tmp_path / "2011_09_30_drive_0099_extract" / "oxts"
        (oxts / "data").mkdir(parents=True, exist_ok=True)
        for number in range(10):
            text = (samples or {}).get(number, sample(wz=0.1 * number))
            if text is not None:
                (oxts / "data" / f"{number:010d}.txt").write_text(text + "\n")
        lines = stamps or [f"2011-09-30 23:59:59.{95 + k:02d}1234567" for k in range(5)] + [
            f"2011-10-01 00:00:00.{k:02d}1234567" for k in range(5)
        ]
        (oxts / "timestamps.txt").write_text("\n".join(lines) + "\n")
        return oxts.parent

    return write


def test_axes_angles_and_times(drive):
    turning = sample(
        yaw=math.radians(30.0), pitch=0.02, roll=0.03, vn=5.0, ve=8.0, vu=-0.5, wx=1, wy=2, wz=3,
        ax=0.4, ay=0.5, az=9.7, lat=49.001, alt=116.0, pos_accuracy=0.5,
    )  # fmt: skip
    log = read_log(drive({4: turning}))
    # Midnight passes after the fifth sample.
    np.testing.assert_allclose(log.imu["t"], np.arange(10) / 100.0, atol=1e-9)
    assert log.metadata.time_origin == pytest.approx(0.951234567, abs=1e-9)
    assert "2011-09-30 23:59:59" in log.metadata.time_scale
    row = log.imu.iloc[4]
    # Forward, left, up become right, forward, up.
    assert row[["gyro_x", "gyro_y", "gyro_z"]].tolist() == [-2.0, 1.0, 3.0]
    assert row[["accel_x", "accel_y", "accel_z"]].tolist() == [-0.5, 0.4, 9.7]
    truth = log.reference.iloc[4]
    assert truth["azimuth"] == pytest.approx(math.radians(60.0))
    # Front down positive becomes nose up positive; left side up is right side down.
    assert (truth["pitch"], truth["roll"]) == (-0.02, 0.03)
    assert truth[["v_e", "v_n", "v_u"]].tolist() == [8.0, 5.0, -0.5]
    assert (truth["lat"], truth["height"]) == pytest.approx((math.radians(49.001), 116.0))
    assert len(log.fixes) == len(log.odometer) == 0
    assert log.metadata.extra["claimed_accuracy"]["position_worst"] == 0.5


def test_the_geoid_is_added_to_the_reference(drive, tmp_path):
    folder = drive()
    descriptor = tmp_path / "x.yaml"
    descriptor.write_text(f"name: x\nformat: kitti\npath: {folder.name}\ngeoid_height: 48.0\n")
    assert read_log(descriptor).reference["height"].tolist() == [163.0] * 10


def test_a_missing_sample_and_a_gap(drive):
    stamps = [f"2011-09-30 12:00:{k // 4:02d}.{25 * (k % 4):02d}0000000" for k in range(10)]
    folder = drive({3: None, 4: None}, stamps)
    log = read_log(folder / "oxts")
    np.testing.assert_allclose(log.imu["t"], np.array([0, 1, 2, 5, 6, 7, 8, 9]) / 4.0)
    assert log.metadata.extra["gaps"] == [[0.5, 0.75]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (" ".join(["1.0"] * 25), r"oxts/data/0000000003.txt: found 25 numbers, expected 30"),
        ("49.0 north", r"oxts/data/0000000003.txt: not numbers \(could not convert"),
        ("", "found 0 numbers"),
    ],
)
def test_a_damaged_sample(drive, text, message):
    with pytest.raises(LogError, match=message):
        read_log(drive({3: text}))


@pytest.mark.parametrize("line", ["", "12:00:00.5", "2011-13-30 12:00:00.5", "b\xe9"])
def test_a_damaged_stamp(drive, line):
    stamps = ["2011-09-30 12:00:00.0", line, *["2011-09-30 12:00:01.0"] * 8]
    with pytest.raises(LogError, match=r"timestamps.txt: line 2 is .*expected a date and time"):
        read_log(drive(stamps=stamps))


def test_stamps_cut_short(drive):
    with pytest.raises(LogError, match=r"data/0000000009.txt has no line in timestamps.txt, which"):
        read_log(drive(stamps=[f"2011-09-30 12:00:00.{k}" for k in range(9)]))
    folder = drive()
    (folder / "oxts" / "timestamps.txt").write_text("\n")
    with pytest.raises(LogError, match=r"timestamps.txt: the file is empty"):
        read_log(folder)


def test_repeated_stamps(drive):
    with pytest.raises(LogError, match=r"row 2 repeats the time of row 1"):
        read_log(drive(stamps=["2011-09-30 12:00:00.5"] * 10))


def test_missing_parts(drive, tmp_path):
    folder = drive()
    with pytest.raises(LogNotFoundError, match=r"no oxts/timestamps.txt in or below it"):
        read_log(folder / "oxts" / "data", format="kitti")
    (tmp_path / "second" / "oxts").mkdir(parents=True)
    (tmp_path / "second" / "oxts" / "timestamps.txt").write_text("x")
    with pytest.raises(LogError, match=r"2 drives below it"):
        read_log(tmp_path)
    with pytest.raises(LogNotFoundError, match=r"no folder data beside timestamps.txt"):
        read_log(tmp_path / "second")
    (tmp_path / "second" / "oxts" / "data").mkdir()
    (tmp_path / "second" / "oxts" / "timestamps.txt").write_text("2011-09-30 12:00:00.5")
    with pytest.raises(LogNotFoundError, match=r"no samples such as 0000000000.txt"):
        read_log(tmp_path / "second")


@pytest.mark.parametrize("name", DRIVES)
def test_published_drives_in_local_metres(name, data_folder):
    """The stated map, and the clock of the poses, are those that agree with velocity and gyro."""
    data_folder("kitti_oxts")
    log = read_log(DATASETS / f"kitti_{name}.yaml")
    reference = log.reference.dropna()
    t = reference["t"].to_numpy()
    place = [torch.tensor(reference[c].to_numpy()) for c in ("lat", "lon", "height")]
    steps = enu_between(*(x[1:] for x in place), *(x[:-1] for x in place))
    for step, velocity in zip(steps[:2], ("v_e", "v_n"), strict=True):
        v = reference[velocity].to_numpy()
        told = 0.5 * (v[1:] + v[:-1]) * np.diff(t)
        # Drive 0028 slides; a gap is no step.
        fair = (np.diff(t) < 0.15) & (np.abs(step.numpy() - told) < 0.05)
        scale = (step.numpy()[fair] @ told[fair]) / (told[fair] @ told[fair])
        assert scale == pytest.approx(1.0, abs=1e-3 if velocity == "v_e" else 4e-3)
    assert np.diff(log.imu["t"].iloc[:3]).max() < 0.02


def test_local_metres_written_as_published_text_come_back(data_folder, tmp_path):
    """The two forms of KITTI share axes, angles and clock, whatever map lies between them."""
    data_folder("kitti_oxts")
    log = read_log(DATASETS / "kitti_0033.yaml").between(20.0, 30.0)
    rows = reference_at(log, log.imu["t"].to_numpy()).assign(**log.imu.drop(columns="t")).dropna()
    oxts = tmp_path / "drive" / "oxts"
    (oxts / "data").mkdir(parents=True)
    start = np.datetime64("2011-09-30T12:00:00", "ns")
    stamps = [str(start + np.timedelta64(round(1e9 * t), "ns")) for t in rows["t"]]
    (oxts / "timestamps.txt").write_text("\n".join(s.replace("T", " ") for s in stamps))
    for k, row in enumerate(rows.to_dict("records")):
        text = sample(
            lat=math.degrees(row["lat"]), lon=math.degrees(row["lon"]), alt=row["height"],
            ve=row["v_e"], vn=row["v_n"], vu=row["v_u"], yaw=math.pi / 2 - row["azimuth"],
            pitch=-row["pitch"], roll=row["roll"],
            wx=row["gyro_y"], wy=-row["gyro_x"], wz=row["gyro_z"],
            ax=row["accel_y"], ay=-row["accel_x"], az=row["accel_z"],
        )  # fmt: skip
        (oxts / "data" / f"{k:010d}.txt").write_text(text)
    back = read_log(oxts)
    np.testing.assert_allclose(back.imu["t"], rows["t"] - rows["t"].iloc[0], atol=1e-8)
    for name in log.imu.columns.drop("t"):
        np.testing.assert_allclose(back.imu[name], rows[name], rtol=1e-13, atol=1e-15)
    for name in log.reference.columns.drop("t"):
        np.testing.assert_allclose(back.reference[name], rows[name], rtol=1e-12, atol=1e-12)


def test_check_of_a_published_drive(data_folder):
    data_folder("kitti_oxts")
    report = check_log(read_log(DATASETS / "kitti_0018.yaml"))
    assert report.ok
    assert {finding.topic for finding in report.findings} == {"gap", "empty table"}
    assert report.figures["reference_latency_s"] == pytest.approx(0.0, abs=0.005)
    assert report.figures["yaw_rate_correlation"] > 0.999
