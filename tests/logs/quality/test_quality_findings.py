"""Each mistake is found and named; a sound log is left in peace."""

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.quality import check_log


def topics(report, severity=None):
    return {f.topic for f in report.findings if severity is None or f.severity == severity}


def test_a_healthy_log_yields_neither_error_nor_warning(healthy):
    report = check_log(healthy)
    assert report.ok
    assert topics(report, "error") == set()
    assert topics(report, "warning") == set()


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_other_healthy_logs_too(drive, seed):
    report = check_log(drive(seed=seed, duration=400.0, gyro_bias=0.005, gyro_step=0.004))
    assert not topics(report, "error") | topics(report, "warning")


@pytest.mark.parametrize(
    ("table", "columns", "topic"),
    [
        ("imu", {"gyro_z": lambda x: -x["gyro_z"]}, "yaw rate sign"),
        ("imu", {"gyro_z": lambda x: np.degrees(x["gyro_z"])}, "yaw rate unit"),
        ("imu", {"gyro_z": lambda x: np.radians(x["gyro_z"])}, "yaw rate unit"),
        ("imu", {"gyro_z": lambda x: 1.15 * x["gyro_z"]}, "yaw rate scale"),
        (
            "imu",
            {"gyro_z": lambda x: x["gyro_y"], "gyro_y": lambda x: x["gyro_z"]},
            "swapped gyro axes",
        ),
        (
            "imu",
            {"gyro_z": lambda x: x["gyro_x"], "gyro_x": lambda x: -x["gyro_z"]},
            "swapped gyro axes",
        ),
        ("odometer", {"speed": lambda x: 3.6 * x["speed"]}, "odometer unit"),
        ("odometer", {"speed": lambda x: 2.2369 * x["speed"]}, "odometer unit"),
        ("odometer", {"speed": lambda x: x["speed"] / 3.6}, "odometer unit"),
        ("odometer", {"speed": lambda x: 1.06 * x["speed"]}, "odometer scale"),
        ("imu", {"accel_z": lambda x: -x["accel_z"]}, "gravity sign"),
        (
            "imu",
            {"accel_x": lambda x: x["accel_z"], "accel_z": lambda x: x["accel_x"]},
            "gravity axis",
        ),
        ("imu", {"accel_z": lambda x: x["accel_z"] - 9.81}, "gravity missing"),
        (
            "imu",
            {f"accel_{a}": (lambda x, a=a: x[f"accel_{a}"] / 9.80665) for a in "xyz"},
            "gravity missing",
        ),
        (
            "imu",
            {"accel_x": lambda x: x["accel_y"], "accel_y": lambda x: -x["accel_x"]},
            "swapped accelerometer axes",
        ),
        ("imu", {"accel_y": lambda x: -x["accel_y"]}, "forward force sign"),
        ("imu", {"accel_x": lambda x: -x["accel_x"]}, "sideways force sign"),
        (
            "fixes",
            {"lat": lambda x: np.degrees(x["lat"]), "lon": lambda x: np.degrees(x["lon"])},
            "degrees for radians",
        ),
        (
            "fixes",
            {"v_e": lambda x: x["v_n"], "v_n": lambda x: x["v_e"]},
            "velocity axes",
        ),
        (
            "fixes",
            {"v_e": lambda x: 3.6 * x["v_e"], "v_n": lambda x: 3.6 * x["v_n"]},
            "velocity unit",
        ),
        ("fixes", {"lat": lambda x: x["lat"].where(x.index != 77, 0.0),
                   "lon": lambda x: x["lon"].where(x.index != 77, 0.0)}, "placeholder position"),
    ],
)  # fmt: skip
def test_a_wrong_unit_axis_or_sign_is_an_error_with_its_name(changed, table, columns, topic):
    report = check_log(changed(table, **columns))
    named = topics(report, "error") | (topics(report, "warning") if "scale" in topic else set())
    assert topic in named
    assert report.ok == (topic not in topics(report, "error"))


def test_one_mistake_does_not_drag_others_behind_it(changed):
    report = check_log(
        changed("fixes", lat=lambda x: np.degrees(x["lat"]), lon=lambda x: np.degrees(x["lon"]))
    )
    assert topics(report, "error") == {"degrees for radians"}
    report = check_log(changed("imu", gyro_z=lambda x: -x["gyro_z"]))
    assert topics(report, "error") == {"yaw rate sign", "sideways force sign"}


def test_time_that_steps_back_repeats_or_lacks_is_told_with_its_row(healthy):
    t = healthy.imu["t"].to_numpy().copy()
    t[1000] = t[990]
    t[2000] = t[1999]
    t[3000] = np.nan
    report = check_log(healthy.with_tables({"imu": healthy.imu.assign(t=t)}))
    by_topic = {f.topic: f for f in report.findings}
    assert by_topic["time reversal"].where == "imu row 1000"
    assert "duplicate stamps" in by_topic
    assert "1 rows without a time" in by_topic["time missing"].found
    assert not report.ok
    assert report.figures["odometer_scale"] == pytest.approx(1.0, abs=0.005)


def test_gaps_are_listed_and_long_ones_are_errors(healthy):
    def pause(start, length):
        kept = (healthy.imu["t"] < start) | (healthy.imu["t"] >= start + length)
        return check_log(healthy.with_tables({"imu": healthy.imu[kept]}))

    short, long = pause(100.0, 3.0), pause(100.0, 20.0)
    assert short.gaps.iloc[0]["table"] == "imu"
    assert short.gaps.iloc[0]["start_s"] == pytest.approx(99.96)
    assert short.gaps.iloc[0]["length_s"] == pytest.approx(3.04)
    assert "gap" in topics(short, "warning")
    assert "gap" in topics(long, "error")


def test_tables_on_different_clocks(healthy):
    odometer = healthy.odometer.assign(t=healthy.odometer["t"] + 5000.0)
    report = check_log(healthy.with_tables({"odometer": odometer}))
    assert "clocks apart" in topics(report, "error")


def test_streams_that_have_nothing_to_do_with_each_other(healthy):
    later = healthy.fixes.assign(t=healthy.fixes["t"] + 17.0)
    report = check_log(healthy.with_tables({"fixes": later[later["t"] < 600.0]}))
    assert {"odometer beside the track", "yaw rate beside the turns"} <= topics(report, "error")


def test_missing_fixes_are_counted(healthy):
    gone = [50, 100, 101, 200, 300]
    report = check_log(healthy.with_tables({"fixes": healthy.fixes.drop(index=gone)}))
    assert report.figures["fixes_missing"] == 5
    assert report.figures["fixes_interruptions"] == 4
    found = next(f for f in report.findings if f.topic == "missing fixes")
    assert "3 of them of a single fix" in found.found


def test_a_frozen_gyro_is_found_in_motion_only(healthy):
    moving, parked = healthy.imu.copy(), healthy.imu.copy()
    hold = (moving["t"] >= 60.0) & (moving["t"] < 64.0)
    moving.loc[hold, "gyro_z"] = moving["gyro_z"][hold].iloc[0]
    hold = (parked["t"] >= 5.0) & (parked["t"] < 15.0)
    parked.loc[hold, "gyro_z"] = parked["gyro_z"][hold].iloc[0]
    found = check_log(healthy.with_tables({"imu": moving})).findings
    assert [f.where for f in found if f.topic == "frozen channel"] == ["imu gyro_z at 60.00 s"]
    assert "frozen channel" not in topics(check_log(healthy.with_tables({"imu": parked})))


def test_a_frozen_odometer_and_repeated_fixes(healthy):
    odometer, fixes = healthy.odometer.copy(), healthy.fixes.copy()
    hold = (odometer["t"] >= 170.0) & (odometer["t"] < 200.0)
    odometer.loc[hold, "speed"] = 12.0
    fixes.loc[60:63, ["lat", "lon"]] = fixes.loc[60, ["lat", "lon"]].to_numpy()
    report = check_log(healthy.with_tables({"odometer": odometer, "fixes": fixes}))
    assert "frozen channel" in topics(report, "error")
    assert report.figures["fixes_repeated_in_motion"] == 3
    assert "repeated fixes" in topics(report, "warning")


def test_a_clipped_channel(changed):
    report = check_log(changed("imu", gyro_z=lambda x: x["gyro_z"].clip(-0.1, 0.1)))
    found = [f for f in report.findings if f.topic == "saturated channel"]
    assert len(found) == 2
    assert {f.severity for f in found} == {"error"}


def test_a_dead_and_an_empty_channel(changed):
    dead = check_log(changed("imu", gyro_z=lambda x: 0.0 * x["gyro_z"]))
    assert "dead channel" in topics(dead, "error")
    empty = check_log(changed("imu", gyro_z=lambda x: x["gyro_z"].where(~x["t"].between(60, 75))))
    assert "empty values" in topics(empty, "error")
    assert empty.figures["imu_gyro_z_missing_share"] == pytest.approx(15.0 / 600.0, abs=1e-3)
    short = check_log(changed("imu", gyro_z=lambda x: x["gyro_z"].where(~x["t"].between(60, 61))))
    assert "empty values" in topics(short, "warning")


def test_quantisation_steps_are_measured(drive):
    report = check_log(drive(gyro_step=np.radians(0.25), odometer_step=1.0 / 3.6))
    assert report.figures["imu_gyro_z_step"] == pytest.approx(np.radians(0.25), rel=1e-6)
    assert report.figures["odometer_speed_step"] == pytest.approx(1.0 / 3.6, rel=1e-6)
    assert "imu_accel_y_step" not in report.figures


def test_outlying_fixes_are_found_with_and_without_a_reference(healthy, without):
    fixes = healthy.fixes.copy()
    fixes.loc[150, "lat"] += 60.0 / 6.37e6
    spike = {"fixes": fixes}
    report = check_log(healthy.with_tables(spike))
    assert {"outlying fixes", "position jumps"} <= topics(report, "warning")
    assert report.figures["fix_error_worst_m"] == pytest.approx(60.0, abs=5.0)
    assert report.figures["fix_error_worst_at_s"] == 151.0
    alone = check_log(without("reference").with_tables(spike))
    jump = next(f for f in alone.findings if f.topic == "position jumps")
    assert "2 steps" in jump.found
    assert "2 return within five fixes, 0 stay" in jump.found
    assert "fix_error_median_m" in alone.not_observable


def test_a_jump_that_stays_is_told_from_one_that_returns(healthy):
    fixes = healthy.fixes.copy()
    fixes.loc[150:, "lat"] += 40.0 / 6.37e6
    report = check_log(healthy.with_tables({"fixes": fixes}))
    jump = next(f for f in report.findings if f.topic == "position jumps")
    assert "0 return within five fixes, 1 stay" in jump.found


def test_heights_above_different_surfaces(changed):
    report = check_log(changed("fixes", height=lambda x: x["height"] + 35.2))
    assert "height datum" in topics(report, "warning")
    assert report.figures["height_offset_m"] == pytest.approx(35.2, abs=0.4)


def test_a_reference_that_slides_against_its_velocity(changed):
    report = check_log(
        changed("reference", lat=lambda x: x["lat"] + 24e-6 / 6.37 * x["t"].clip(90, 110) / 20)
    )
    found = next(f for f in report.findings if f.topic == "sliding reference")
    assert 90.0 < float(found.where.split()[2]) < 140.0


def test_interpolated_fixes_are_counted(healthy):
    fixes = healthy.fixes.copy()
    filled = [60, 61, 62, 180, 181, 182, 183, 300, 301, 420]
    fixes.loc[filled, ["lat", "lon"]] = np.nan
    fixes[["lat", "lon"]] = fixes[["lat", "lon"]].interpolate()
    report = check_log(healthy.with_tables({"fixes": fixes}))
    moving = check_log(healthy).figures["fixes_interpolated_share"]
    assert moving == 0.0
    assert "interpolated fixes" in topics(report, "info")


def test_the_text_holds_every_finding_and_figure(changed):
    report = check_log(changed("imu", gyro_z=lambda x: -x["gyro_z"]))
    text = report.to_text()
    assert text.startswith("made: NOT usable (2 error, 0 warning")
    assert all(f.topic in text and f.remedy in text for f in report.findings)
    assert "odometer_scale" in text
    assert "±" in text
    assert isinstance(report.gaps, pd.DataFrame)
