import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.reading import read_log, recognise_format
from navlearn.logs.reference import reference_at, reference_from_fixes

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
TIMES = [0.0, 0.3, 0.5, 0.7]
# Equator and prime meridian, 100 m up: latitude, longitude and height are plain there.
PLACE = (6378237.0, 0.0, 0.0)


def ranges(name="pseudorange3", glonass=320, t=TIMES):
    lines = []
    for at in t:
        lines.append(f"{name} {at} 21000000.5 25 26000000 1000000 5000000 12 1 60.5 49   ")
        lines.append(f"{name} {at} 20000000.25 64 25000000 -3000000 4000000 {glonass} 4 55 40")
    return lines


def odometry(t=TIMES):
    return [
        f"odom3 {at} {5.0 + at} 0 0 0 0 {-0.1 * at} 0.0025 9e-4 9e-4 4e-06 4e-06 4e-06     "
        for at in t
    ]


def truth(t=TIMES):
    return [f"point3 {at} {PLACE[0]} {at} 0 0 0 0 0 0 0 0 0 0      " for at in t]


@pytest.fixture
def drive(tmp_path):
    def write(*lines, name="Street_Input.txt", gt=True):
        folder = tmp_path / "smartLoc"
        folder.mkdir(exist_ok=True)
        (folder / name).write_text("\n".join(lines or (*odometry(), *ranges())) + "\n")
        if gt:
            (folder / "Street_GT.txt").write_text("\n".join(truth()) + "\n")
        return folder

    return write


def test_what_a_drive_holds(drive):
    folder = drive()
    assert recognise_format(folder) == "smartloc"
    assert recognise_format(folder / "Street_Input.txt") == "smartloc"
    log = read_log(folder.parent)
    assert log.imu.columns.tolist() == ["t", "gyro_z"]
    np.testing.assert_allclose(log.imu["gyro_z"], [0.0, -0.03, -0.05, -0.07])
    np.testing.assert_allclose(log.odometer["speed"], [5.0, 5.3, 5.5, 5.7])
    assert log.fixes.empty
    assert log.reference["t"].tolist() == TIMES
    assert log.reference["height"].iloc[0] == pytest.approx(100.0, abs=1e-6)
    np.testing.assert_allclose(log.reference["lon"], np.array(TIMES) / PLACE[0], rtol=1e-9)
    assert log.ranges["satellite"].tolist() == ["G12", "R20"] * 4
    first = log.ranges.iloc[1]
    assert first[["pseudorange", "cn0", "std_range"]].tolist() == [20000000.25, 40.0, 8.0]
    assert first[["sat_x", "sat_y", "sat_z"]].tolist() == [25e6, -3e6, 4e6]
    assert log.metadata.range_corrections == ("satellite_clock", "ionosphere", "troposphere")
    assert log.metadata.gps_time_origin is None


@pytest.mark.parametrize(
    ("name", "number", "system", "satellite"),
    [
        ("range3", 52, 4, "R20"),
        ("pseudorange3", 301, 4, "R01"),
        ("range3", 7, 4, "R07"),
        ("range3", 8, 8, "E08"),
        ("range3", 133, 2, "S33"),
        ("range3", 193, 16, "J01"),
        ("range3", 30, 32, "C30"),
    ],
)
def test_satellites_by_their_rinex_names(drive, name, number, system, satellite):
    line = f"{name} 0 2.1e7 25 26000000 1000000 5000000 {number} {system} 60.5 49"
    log = read_log(drive(*odometry(), line))
    assert log.ranges["satellite"].tolist() == [satellite]


def test_records_of_other_kinds_and_order_do_no_harm(drive):
    mixed = ["odom2 0 1 2", "", *ranges("range3", 52, [0.5]), *ranges("pseudorange3", 320, [0.0])]
    log = read_log(drive(*mixed, *odometry()), format="smartloc")
    assert log.ranges["t"].tolist() == [0.0, 0.0, 0.5, 0.5]
    assert log.ranges["satellite"].tolist() == ["G12", "R20"] * 2


def test_the_ground_truth_is_optional(drive):
    log = read_log(drive(gt=False))
    assert log.reference is None
    assert len(log.ranges) == 8


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (odometry(), "Street_Input.txt: no record pseudorange3"),
        (ranges(), "Street_Input.txt: no record odom3"),
        ([*odometry(), "range3 0 2e7 25 1 2 3"], "line 5: range3 with 6 numbers, expected 10"),
        ([*odometry(), *ranges(t=["x"])], "line 5: pseudorange3: could not convert .*'x'"),
        ([*odometry(), *ranges(glonass=3.5)], "satellite 3.5 of system 4; known systems are 1"),
        ([*odometry(), *ranges(glonass="nan")], "satellite nan of system 4; known systems are 1"),
        (
            [*odometry(), "range3 0 2e7 25 26000000 0 0 3 inf 50 40"],
            "pseudorange3 of satellite 3 of system inf",
        ),
        (
            [*odometry(), "range3 0 2e7 -1 26000000 0 0 3 1 50 40"],
            "pseudorange3 at 0 s has a negative variance",
        ),
        (
            [*odometry(), *ranges(), "range3 0.7 2.1e7 1 26000000 0 0 12 1 50 40"],
            "satellite G12 comes twice at 0.7 s",
        ),
        ([*odometry(), *ranges(t=["nan"])], "no time at row 1"),
        ([*odometry([0.3, 0.0]), *ranges()], "time steps back at row 2"),
    ],
)
def test_damaged_records(drive, lines, said):
    with pytest.raises(LogError, match=said):
        read_log(drive(*lines), format="smartloc")


def test_several_drives_and_none(drive, tmp_path):
    folder = drive()
    drive(name="Road_Input.txt")
    with pytest.raises(LogError, match=r"2 drives below it \(Road_Input.txt, Street_Input.txt\)"):
        read_log(folder)
    assert len(read_log(folder / "Road_Input.txt").ranges) == 8
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogNotFoundError, match=r"no …_Input\.txt in or below it"):
        read_log(tmp_path / "empty", format="smartloc")
    (folder / "Road_Input.txt").write_bytes(b"odom3 \xff\xfe 1")
    with pytest.raises(LogError, match=r"Road_Input\.txt: not readable as text"):
        read_log(folder / "Road_Input.txt")


@pytest.mark.parametrize(("name", "csv"), [("smartloc", "csv"), ("smartloc_rtklib", "csv_rtklib")])
def test_the_published_drive_equals_its_csv(data_folder, name, csv):
    """Ranges, yaw rate, speed and truth; rotated satellites and elevations of other hands."""
    home = data_folder("smartloc_potsdamer") / csv
    log = read_log(DATASETS / f"{name}.yaml")
    other = pd.read_csv(home / "pseudoranges.csv.gz")
    assert len(log.ranges) == len(other) == 12211
    for mine, theirs in {
        "t": "t",
        "pseudorange": "pseudorange",
        "cn0": "cn0",
        "sat_x": "sat_x_published",
        "sat_y": "sat_y_published",
        "sat_z": "sat_z",
    }.items():
        assert np.abs(log.ranges[mine] - other[theirs]).max() < 5.1e-5, mine
    np.testing.assert_allclose(log.ranges["std_range"] ** 2, other["pr_var"])
    number = other["sat"].where(other["constellation"] == "G", other["sat"] % 300 % 32)
    expected = other["constellation"] + number.astype(str).str.zfill(2)
    assert (log.ranges["satellite"] == expected).all()
    assert np.abs(log.imu["gyro_z"] - pd.read_csv(home / "imu.csv.gz")["gyro_z"]).max() < 1e-9
    truth_csv = pd.read_csv(home / "reference.csv.gz")
    assert np.abs(log.reference["lat"] - np.radians(truth_csv["lat"])).max() < 1e-11
    assert np.abs(log.reference["height"] - truth_csv["alt"]).max() < 1e-4
    series = ranges_of(log, np.arange(0.0, 170.4, 0.1))
    rows = np.searchsorted(series.t.numpy(), log.ranges["t"])
    slots = log.ranges["satellite"].map({s: k for k, s in enumerate(series.satellites)}).to_numpy()
    turned = series.ranges.satellite.numpy()[rows, slots]
    assert np.abs(turned - other[["sat_x", "sat_y", "sat_z"]]).to_numpy().max() < 1e-3
    seen = series.ranges.elevation.numpy()[rows, slots]
    assert np.abs(seen - np.radians(other["elevation_deg"])).max() < math.radians(0.003)


def test_both_variants_hear_the_same_satellites(data_folder):
    data_folder("smartloc_potsdamer")
    one, two = (read_log(DATASETS / f"{name}.yaml") for name in ("smartloc", "smartloc_rtklib"))
    assert set(one.ranges["satellite"]) == set(two.ranges["satellite"])
    bare = replace(one, reference=None)
    with pytest.raises(LogError, match=r"neither a reference nor fixes .*with_single_point_fixes"):
        reference_from_fixes(bare)
    moved = reference_at(one, one.imu["t"].to_numpy())
    assert moved["lat"].notna().all()
