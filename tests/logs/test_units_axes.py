import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navlearn.errors import ConfigError
from navlearn.logs.axes import (
    levelling_matrix,
    matrix_from_directions,
    matrix_from_letters,
    turned,
)
from navlearn.logs.units import factor_to_si, split_suffix


@pytest.mark.parametrize(
    ("unit", "column", "value", "si"),
    [
        ("deg", "lat", 180.0, math.pi),
        ("km/h", "speed", 90.0, 25.0),
        ("mph", "v_e", 1.0, 0.44704),
        ("knot", "speed", 1.0, 0.514444444),
        ("deg/s", "gyro_z", 90.0, math.pi / 2),
        ("deg/h", "gyro_z", 15.041, 7.29208e-5),
        ("g", "accel_z", 1.0, 9.80665),
        ("ms", "t", 1500.0, 1.5),
        ("ft", "height", 10.0, 3.048),
        ("cm/s", "std_v", 10.0, 0.1),
    ],
)
def test_units(unit, column, value, si):
    assert value * factor_to_si(unit, column) == pytest.approx(si, rel=1e-5)


def test_a_unit_of_another_kind():
    with pytest.raises(ConfigError, match=r"column speed: unit 'kmh' is no unit of speed.*'km/h'"):
        factor_to_si("kmh", "speed")
    with pytest.raises(ConfigError, match="column lat: unit 'm' is no unit of angle"):
        factor_to_si("m", "lat")


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("lat_deg", ("lat", "deg")),
        ("speed_kmh", ("speed", "km/h")),
        ("speed_km_per_h", ("speed", "km/h")),
        ("speed_m_per_s", ("speed", "m/s")),
        ("accel_x_m_per_s2", ("accel_x", "m/s2")),
        ("gyro_z_deg_per_s", ("gyro_z", "deg/s")),
        ("azimuth_deg", ("azimuth", "deg")),
        ("accel_x_g", ("accel_x", "g")),
        ("t_ms", ("t", "ms")),
        ("speed_deg", None),
        ("lat", None),
        ("lat_error", None),
    ],
)
def test_suffixes(name, found):
    columns = {"t", "lat", "speed", "gyro_z", "azimuth", "accel_x"}
    assert split_suffix(name, columns) == found


def test_letters_and_directions_agree():
    np.testing.assert_array_equal(
        matrix_from_letters("FLU"), matrix_from_directions(right="-y", forward="x", up="z")
    )
    np.testing.assert_array_equal(
        matrix_from_letters("UBR"), matrix_from_directions(right="z", forward="-y", up="x")
    )
    np.testing.assert_array_equal(matrix_from_letters("RFU"), np.eye(3))
    frd = matrix_from_letters("FRD")
    np.testing.assert_array_equal(frd @ [1.0, 2.0, 3.0], [2.0, 1.0, -3.0])


@pytest.mark.parametrize("letters", ["FRU", "FFU", "FL", "XYZ", ""])
def test_letters_that_are_no_triad(letters):
    with pytest.raises(ConfigError, match="axes: "):
        matrix_from_letters(letters)


def test_directions_that_are_no_triad():
    with pytest.raises(ConfigError, match="no right-handed triad"):
        matrix_from_directions(right="y", forward="x", up="z")
    with pytest.raises(ConfigError, match=r"axes.forward: found 'w'; give x, y or z"):
        matrix_from_directions(right="y", forward="w", up="z")


def test_an_imu_is_turned_whole():
    imu = pd.DataFrame({"t": [0.0], "gyro_x": [1.0], "gyro_y": [2.0], "gyro_z": [3.0]})
    imu = imu.assign(accel_x=4.0, accel_y=5.0, accel_z=6.0, temperature=21.0)
    found = turned(imu, matrix_from_letters("UBR"))
    assert found[["gyro_x", "gyro_y", "gyro_z"]].iloc[0].tolist() == [3.0, -2.0, 1.0]
    assert found[["accel_x", "accel_y", "accel_z"]].iloc[0].tolist() == [6.0, -5.0, 4.0]
    assert found["temperature"].iloc[0] == 21.0


def test_a_single_gyro_goes_where_it_points():
    imu = pd.DataFrame({"t": [0.0], "gyro_z": [3.0]})
    assert turned(imu, matrix_from_letters("FRD"))["gyro_z"].iloc[0] == -3.0
    assert "gyro_z" not in turned(imu, matrix_from_letters("UBR"))


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_levelling_makes_a_tilted_parked_sensor_read_gravity_up(pitch, roll):
    g = 9.8
    tilted = [
        -g * math.cos(pitch) * math.sin(roll),
        g * math.sin(pitch),
        g * math.cos(pitch) * math.cos(roll),
    ]
    level = levelling_matrix(pitch=pitch, roll=roll) @ tilted
    np.testing.assert_allclose(level, [0.0, 0.0, g], atol=1e-12)


def test_a_sensor_turned_about_the_vertical():
    # Its forward axis points 30° to the right of the car's: what it calls forward is right too.
    turn = levelling_matrix(yaw=np.radians(30.0), pitch=0.0, roll=0.0)
    np.testing.assert_allclose(
        turn @ np.array([0.0, 1.0, 0.0]), [0.5, np.cos(np.radians(30.0)), 0.0], atol=1e-15
    )
