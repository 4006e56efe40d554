import math

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import LogError
from navlearn.logs.drive_log import LogMetadata
from navlearn.logs.validate import validate_log


def bent(tables, name, **columns):
    return {name: tables[name].assign(**columns)}


def test_a_good_log_passes_as_float64(make_log, tables):
    odometer = pd.DataFrame({"t": range(20), "speed": range(20)})
    log = validate_log(make_log(odometer=odometer))
    assert {str(t) for table in log.tables().values() for t in table.dtypes} == {"float64"}
    pd.testing.assert_frame_equal(log.imu, tables["imu"])


@pytest.mark.parametrize(("name", "column"), [("imu", "gyro_z"), ("odometer", "speed")])
def test_missing_column(make_log, tables, name, column):
    other = tables[name].rename(columns={column: f"{column}s"})
    with pytest.raises(LogError, match=rf"{name}: no column {column} \(did you mean '{column}s'"):
        validate_log(make_log(**{name: other}))


def test_missing_time(make_log, tables):
    with pytest.raises(LogError, match=r"imu: no column t.*found gyro_x"):
        validate_log(make_log(imu=tables["imu"].drop(columns="t")))


@pytest.mark.parametrize("name", ["imu", "reference"])
def test_empty_table(make_log, tables, name):
    with pytest.raises(LogError, match=rf"{name}: found 0 rows"):
        validate_log(make_log(**{name: tables[name].iloc[:0]}))


def test_fixes_may_be_lacking_where_a_reference_can_stand_in(make_log, tables):
    none = tables["fixes"].iloc[:0]
    assert validate_log(make_log(fixes=none)).fixes.empty
    with pytest.raises(LogError, match="fixes: found 0 rows"):
        validate_log(make_log(fixes=none, reference=None))


def test_a_car_without_odometer_is_sound_but_an_empty_file_is_not(make_log, tables):
    none = tables["odometer"].iloc[:0]
    assert validate_log(make_log(odometer=none)).odometer.empty
    known = LogMetadata(name="small", extra={"files": {"odometer": "odometer.csv"}})
    with pytest.raises(LogError, match=r"odometer.csv: found 0 rows"):
        validate_log(make_log(odometer=none, metadata=known))
    with pytest.raises(LogError, match=r"odometer: found 1 rows"):
        validate_log(make_log(odometer=tables["odometer"].iloc[:1]))


def test_times_that_are_no_seconds(make_log, tables):
    t = tables["imu"]["t"] * 1e9 + 1.7e18
    with pytest.raises(LogError, match=r"imu: t is 1.7e\+18 at row 1, no time in seconds; give"):
        validate_log(make_log(**bent(tables, "imu", t=t)))


def test_nan_block_names_row_time_and_length(make_log, tables):
    gyro = tables["imu"]["gyro_z"].copy()
    gyro[30:42] = np.nan
    gyro[60] = np.nan
    message = (
        r"gyro_z has no value in 12 rows from row 31 \(t = 3 to 4.1 s; 13 rows in all\); remove"
    )
    with pytest.raises(LogError, match=message):
        validate_log(make_log(**bent(tables, "imu", gyro_z=gyro)))


def test_nan_block_at_the_end(make_log, tables):
    speed = tables["odometer"]["speed"].copy()
    speed[-3:] = np.nan
    with pytest.raises(LogError, match="no value in 3 rows from row 19"):
        validate_log(make_log(**bent(tables, "odometer", speed=speed)))


def test_a_fix_with_velocity_alone_passes(make_log, tables):
    fixes = tables["fixes"].copy()
    fixes.loc[4, ["lat", "lon"]] = np.nan
    assert len(validate_log(make_log(fixes=fixes)).fixes) == 11
    fixes.loc[4, "v_e"] = np.nan
    with pytest.raises(LogError, match="fixes: column lat has no value in 1 rows from row 5"):
        validate_log(make_log(fixes=fixes))


def test_time_runs_back(make_log, tables):
    t = tables["imu"]["t"].copy()
    t[50:] -= 0.25
    message = r"time steps back at row 51 \(4.75 s after 4.9 s; 1 such rows\); sort the file or set"
    with pytest.raises(LogError, match=message):
        validate_log(make_log(**bent(tables, "imu", t=t)))


def test_duplicate_stamps(make_log, tables):
    t = tables["odometer"]["t"].copy()
    t[7] = t[6]
    with pytest.raises(LogError, match=r"row 8 repeats the time of row 7 \(3 s; 1 such rows\)"):
        validate_log(make_log(**bent(tables, "odometer", t=t)))


def test_missing_stamps(make_log, tables):
    t = tables["odometer"]["t"].copy()
    t[7] = np.nan
    with pytest.raises(LogError, match="no time at row 8"):
        validate_log(make_log(**bent(tables, "odometer", t=t)))


def test_degrees_for_radians(make_log, tables):
    degrees = bent(tables, "fixes", lat=44.23)
    with pytest.raises(LogError, match=r"lat is 44.23 at row 1.*lat_deg or give unit: deg"):
        validate_log(make_log(**degrees))
    with pytest.raises(LogError, match=r"reference: lon is -76.49 at row 1"):
        validate_log(make_log(**bent(tables, "reference", lon=-76.49)))


def test_degrees_per_second_for_radians(make_log, tables):
    gyro = np.degrees(tables["imu"]["gyro_z"]) * 10.0
    with pytest.raises(LogError, match=r"gyro_z exceeds .* rad/s in 1 % of its rows"):
        validate_log(make_log(**bent(tables, "imu", gyro_z=gyro)))


def test_one_spike_of_the_gyro_is_left_to_the_quality_checks(make_log, tables):
    gyro = tables["imu"]["gyro_z"].copy()
    gyro[50] = 30.0
    validate_log(make_log(**bent(tables, "imu", gyro_z=gyro)))


def test_impossible_speed(make_log, tables):
    speed = tables["odometer"]["speed"].copy()
    speed[5:8] = 131.0
    message = r"speed is 131 m/s at row 6 \(3 rows above 120 m/s\); if it is in km/h"
    with pytest.raises(LogError, match=message):
        validate_log(make_log(**bent(tables, "odometer", speed=speed)))


def test_infinite_value(make_log, tables):
    accel = tables["imu"]["accel_x"].copy()
    accel[3] = math.inf
    with pytest.raises(LogError, match="accel_x is infinite at row 4"):
        validate_log(make_log(**bent(tables, "imu", accel_x=accel)))


def test_text_among_numbers(make_log, tables):
    speed = tables["odometer"]["speed"].astype(object)
    speed[9] = "fast"
    with pytest.raises(LogError, match="column speed holds 'fast' at row 10, expected numbers"):
        validate_log(make_log(**bent(tables, "odometer", speed=speed)))


def test_messages_name_the_file(make_log, tables):
    metadata = LogMetadata(name="x", extra={"files": {"imu": "imu_2.csv.gz"}})
    empty = tables["imu"].iloc[:0]
    with pytest.raises(LogError, match=r"^imu_2\.csv\.gz: found 0 rows"):
        validate_log(make_log(imu=empty, metadata=metadata))
