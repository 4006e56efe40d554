import numpy as np
import pytest
import scipy.io

from navlearn.errors import LogError, LogNotFoundError
from navlearn.logs.formats.navinst_ranges import read_navinst_ranges
from navlearn.logs.reading import read_log

N = 30
SECONDS = 152142 + np.arange(N, dtype=np.int32)[:, None]


def column(values):
    return np.broadcast_to(np.asarray(values, dtype=np.float64), N)[:, None]


def variables():
    """Return 30 s of a drive as the laboratory's MATLAB variables, by file."""
    imu_t = 152143.09 + np.arange(200) / 10.0
    triad = {axis: np.full((1, 200), 0.01 * k) for k, axis in enumerate("xyz", start=1)}
    return {
        "f_w_IMSseconds_dt.mat": {
            "IMU_second": imu_t[None, :],
            "w": triad,
            "f": {"x": triad["x"], "y": triad["y"], "z": triad["z"] + 9.8},
            "sample_time": np.full((1, 999), 0.1),
        },
        "OBDII_Speed/CarChip_Speed_interpolated.mat": {
            "CarChip_second_1HZ": SECONDS,
            "CarChip_Speed_1HZ": column(np.arange(N)),
            "CarChip_Speed_10HZ": np.zeros((N * 10, 1)),
        },
        "rover/Mat/BESTGPSPOS.mat": {
            "BGP_second": SECONDS,
            "BGP_Lat": column(44.23),
            "BGP_Long": column(-76.46),
            "BGP_Alt": column(73.7),
            "BGP_Lat_std": column(1.5),
            "BGP_Long_std": column(1.4),
            "BGP_Alt_std": column(3.5),
        },
        "rover/Mat/BESTGPSVEL.mat": {
            "BGV_second": SECONDS[3:],
            "BGV_ve": column(1.0)[3:],
            "BGV_vn": column(2.0)[3:],
            "BGV_vu": column(0.5)[3:],
        },
        "rover/Mat/INSPVA.mat": {
            "INS_second": SECONDS,
            "INS_Lat": column(44.23),
            "INS_Long": column(-76.46),
            "INS_Alt": column(39.9),
            "INS_ve": column(1.0),
            "INS_vn": column(2.0),
            "INS_vu": column(0.5),
            "INS_Roll": column(-0.2),
            "INS_Pitch": column(-0.3),
            "INS_Azi": column(199.7),
        },
    }


def cells(rows, *, standing=False):
    found = np.empty((1, len(rows)), dtype=object)
    for k, row in enumerate(rows):
        found[0, k] = np.atleast_2d(np.asarray(row, dtype=np.float64))
        if standing:
            found[0, k] = found[0, k].T
    return found


def raw_ranges():
    """Return three receptions of the GPS receiver, the second of them without a satellite."""
    heard = [[22, 5], [], [5]]
    standing = {
        "Sat_Num": heard,
        "Rho_GPS": [[2.3e7, 2.4e7], [], [2.5e7]],
        "Rho_GPS_std": [[0.1, 0.2], [], [0.3]],
        "Dopp_GPS": [[1000.0, -2000.0], [], [0.0]],
        "Sat_Clk_Corr": [[100.0, 200.0], [], [300.0]],
        "Sat_Ion_Corr": [[-5.0, 6.0], [], [7.0]],
        "Sat_Tro_Corr": [[2.0, 3.0], [], [4.0]],
        "Sat_X": [[2e7, 1.5e7], [], [1e7]],
        "Sat_Y": [[1e7, -1.5e7], [], [-2e7]],
        "Sat_Z": [[1e7, 1.5e7], [], [1.2e7]],
    }
    lying = {f"Sat_V{axis}": [[1.0, 2.0], [], [3.0]] for axis in "XYZ"}
    seconds = np.array([[152142, 152143, 152144]], dtype=np.int32)
    weeks = np.full((1, 3), 1485, dtype=np.uint16)
    return {
        "rover/Mat/Raw_Data_combined.mat": {
            "RAW_second": seconds,
            "RAW_week": weeks,
            **{name: cells(rows, standing=True) for name, rows in standing.items()},
            **{name: cells(rows) for name, rows in lying.items()},
        },
        # the receiver heard one satellite more, in another order
        "rover/Mat/PointPositioning/GPS_Data_Combined_Nova.mat": {
            "GPS_sec": seconds,
            "GPS_week": weeks,
            "sv_no": cells([[5, 9, 22], [9], [9]]),
            "c_2_n_L1": cells([[41, 30, 44], [31], [32]]),
        },
        "rover/Mat/IONUTC.mat": {
            f"{letter}{power}": np.full((5, 1), 10.0 * (letter == "b") + power)
            for letter in "ab"
            for power in range(4)
        },
    }


@pytest.fixture
def raw_drive(drive, tmp_path):
    def write(**changes):
        folder = drive()
        for path, found in raw_ranges().items():
            file = folder / path
            file.parent.mkdir(parents=True, exist_ok=True)
            kept = {**found, **changes.get(file.stem, {})}
            scipy.io.savemat(file, {k: v for k, v in kept.items() if v is not None})
        return folder

    return write


@pytest.fixture
def drive(tmp_path):
    def write(**changes):
        for path, found in variables().items():
            file = tmp_path / "drive" / path
            file.parent.mkdir(parents=True, exist_ok=True)
            kept = {**found, **changes.get(file.stem, {})}
            scipy.io.savemat(file, {k: v for k, v in kept.items() if v is not None})
        return tmp_path / "drive"

    return write


def test_axes_units_and_datum(drive):
    log = read_log(drive())
    assert log.metadata.time_origin == 152142.0
    assert log.metadata.interval_means == ("imu",)
    np.testing.assert_allclose(log.imu["t"].iloc[:2], [1.09, 1.19])
    first = log.imu.iloc[0]
    assert first[["gyro_x", "gyro_y", "gyro_z"]].tolist() == [0.01, 0.02, 0.03]
    assert first["accel_z"] == pytest.approx(9.83)
    assert log.odometer["speed"].tolist() == list(range(N))
    fix = log.fixes.iloc[5]
    assert fix["lat"] == pytest.approx(np.radians(44.23))
    # Heights above mean sea level become ellipsoidal as the reference's are.
    assert fix["height"] == pytest.approx(73.7 - 35.2)
    assert (fix["std_e"], fix["std_n"], fix["v_e"], fix["v_n"]) == (1.4, 1.5, 1.0, 2.0)
    assert log.fixes["v_e"].isna().tolist() == [True] * 3 + [False] * (N - 3)
    truth = log.reference.iloc[0]
    assert truth["azimuth"] == pytest.approx(np.radians(199.7))
    assert (truth["height"], truth["roll"]) == pytest.approx((39.9, np.radians(-0.2)))


def test_optional_files_may_be_missing(drive):
    folder = drive()
    (folder / "rover/Mat/BESTGPSVEL.mat").unlink()
    (folder / "rover/Mat/INSPVA.mat").unlink()
    log = read_log(folder)
    assert log.reference is None
    assert "v_e" not in log.fixes


@pytest.mark.parametrize("name", ["f_w_IMSseconds_dt.mat", "BESTGPSPOS.mat"])
def test_a_missing_file(drive, name):
    folder = drive()
    next(folder.rglob(name)).unlink()
    with pytest.raises(LogNotFoundError, match=rf"no {name} in or below it.*found OBDII_Speed/"):
        read_log(folder)


def test_two_drives_in_one_folder(drive, tmp_path):
    folder = drive()
    (tmp_path / "second").mkdir()
    (folder / "f_w_IMSseconds_dt.mat").rename(tmp_path / "second" / "f_w_IMSseconds_dt.mat")
    drive()
    with pytest.raises(LogError, match="2 drives below it"):
        read_log(tmp_path)


@pytest.mark.parametrize("name", sorted(path.rsplit("/")[-1] for path in variables()))
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.97])
def test_a_truncated_file(drive, name, share):
    folder = drive()
    path = next(folder.rglob(name))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(LogError, match=rf"^{name}: .*(truncated|fetch it again)"):
        read_log(folder)


def test_a_file_that_is_no_matlab(drive):
    folder = drive()
    next(folder.rglob("INSPVA.mat")).write_text("this is a text, not a MATLAB file\n" * 20)
    with pytest.raises(LogError, match=r"^INSPVA\.mat: not readable as a MATLAB 5 file"):
        read_log(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"INSPVA": {"INS_Azi": None}}, r"^INSPVA\.mat: no variable INS_Azi; found INS_"),
        ({"INSPVA": {"INS_Azi": np.zeros((5, 1))}}, r"variables differ in length"),
        ({"f_w_IMSseconds_dt": {"w": None}}, r"no structure w with fields x, y, z"),
        (
            {"f_w_IMSseconds_dt": {"f": {"x": "a", "y": 1.0, "z": 2.0}}},
            r"variable x is not numbers",
        ),
        ({"f_w_IMSseconds_dt": {"f": {"x": 1.0}}}, r"structure f has no field y"),
        ({"BESTGPSPOS": {"BGP_Lat": np.array([["text"]])}}, r"variable BGP_Lat is not numbers"),
    ],
)
def test_damaged_variables(drive, changes, message):
    with pytest.raises(LogError, match=message):
        read_log(drive(**changes))


def test_raw_ranges(raw_drive):
    log = read_log(raw_drive())
    ranges = log.ranges
    assert ranges["satellite"].tolist() == ["G22", "G05", "G05"]
    assert ranges["t"].tolist() == [0.0, 0.0, 2.0]
    assert ranges["pseudorange"].tolist() == [2.3e7, 2.4e7, 2.5e7]
    wavelength = 299792458.0 / 1575.42e6
    np.testing.assert_allclose(ranges["range_rate"], [-1000.0 * wavelength, 2000 * wavelength, 0])
    np.testing.assert_array_equal(ranges["cn0"], [44.0, 41.0, np.nan])
    assert ranges["sat_clock"].tolist() == [100.0, 200.0, 300.0]
    assert ranges["ionosphere"].tolist() == [-5.0, 6.0, 7.0]
    assert ranges["troposphere"].tolist() == [2.0, 3.0, 4.0]
    assert ranges["std_range"].tolist() == [0.1, 0.2, 0.3]
    assert ranges[["sat_x", "sat_y", "sat_z", "sat_vz"]].iloc[2].tolist() == [1e7, -2e7, 1.2e7, 3]
    assert log.metadata.range_corrections == ("earth_rotation",)
    assert log.metadata.klobuchar == (0.0, 1.0, 2.0, 3.0, 10.0, 11.0, 12.0, 13.0)
    assert log.metadata.gps_time_origin == 1485 * 604800.0 + 152142.0


def test_the_files_of_raw_ranges_are_optional(raw_drive):
    folder = raw_drive()
    next(folder.rglob("IONUTC.mat")).unlink()
    next(folder.rglob("GPS_Data_Combined_Nova.mat")).unlink()
    log = read_log(folder)
    assert log.metadata.klobuchar == ()
    assert "cn0" not in log.ranges
    next(folder.rglob("Raw_Data_combined.mat")).unlink()
    log = read_log(folder)
    assert log.ranges is None
    assert log.metadata.range_corrections == ()


def test_a_week_ends_during_the_drive(raw_drive):
    turn = {
        "RAW_second": np.array([[604799, 0, 1]], dtype=np.int32),
        "RAW_week": np.array([[1484, 1485, 1485]], dtype=np.uint16),
    }
    folder = raw_drive(Raw_Data_combined=turn)
    next(folder.rglob("GPS_Data_Combined_Nova.mat")).unlink()
    found = read_navinst_ranges(folder)
    assert found.table["t"].tolist() == [604799.0, 604799.0, 604801.0]
    assert found.gps_time_origin == 1484 * 604800.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"Rho_GPS": cells([[2.3e7], [], [2.5e7]])}, "Rho_GPS does not hold a value for each"),
        ({"Dopp_GPS": cells([[1.0, 2.0], []])}, r"Dopp_GPS .* cell 3"),
        ({"Sat_X": None}, "no variable Sat_X; found"),
        ({"Sat_Num": np.array([[22.0, 5.0]])}, "Sat_Num is no row of cells"),
        ({"Sat_Num": cells([[22, 45], [], [5]])}, "satellite 45 is no GPS satellite"),
        ({"RAW_week": np.full((1, 2), 1485)}, "3 times and 2 weeks for 3 receptions"),
        ({"Sat_Num": cells([[5, 5], [], [5]])}, "satellite G05 comes twice"),
        ({"Sat_Clk_Corr": np.array([["a", "b"]], dtype=object)}, "Sat_Clk_Corr is not numbers"),
    ],
)
def test_damaged_raw_ranges(raw_drive, change, said):
    with pytest.raises(LogError, match=said):
        read_log(raw_drive(Raw_Data_combined=change))


def test_an_empty_ionosphere(raw_drive):
    with pytest.raises(LogError, match="hold no values"):
        read_log(raw_drive(IONUTC={"b3": np.zeros((0, 1))}))
