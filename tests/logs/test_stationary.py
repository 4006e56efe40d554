import numpy as np
import pytest

from navlearn.logs.stationary import StationaryOptions, stationary_intervals

EDGES = np.arange(0, 601) / 10.0
ODOMETER_T = np.arange(0, 121) / 2.0


def stop_between(start, stop):
    standing = np.abs(ODOMETER_T - 0.5 * (start + stop)) <= 0.5 * (stop - start)
    return np.where(standing, 0.0, 8.0)


def test_a_stop_is_believed_late_and_given_up_early():
    still = stationary_intervals(EDGES, ODOMETER_T, stop_between(20.0, 40.0))
    ends = EDGES[1:][still]
    assert ends[0] == pytest.approx(21.1)
    assert ends[-1] == pytest.approx(39.5)
    assert still.sum() == round((39.5 - 21.0) * 10)


def test_a_stop_shorter_than_its_margins_is_none():
    assert not stationary_intervals(EDGES, ODOMETER_T, stop_between(20.0, 21.0)).any()


def test_a_crawl_is_not_standing():
    crawl = np.full(ODOMETER_T.size, 0.3)
    assert not stationary_intervals(EDGES, ODOMETER_T, crawl).any()


def test_the_ends_of_the_odometer_are_not_believed():
    still = stationary_intervals(EDGES, ODOMETER_T, np.zeros(ODOMETER_T.size))
    assert not still[:10].any()
    assert not still[-5:].any()
    assert still[10:-5].all()


@pytest.mark.parametrize("channel", ["yaw_rate", "acceleration"])
def test_a_restless_imu_contradicts_the_odometer(channel):
    imu_t = np.arange(0, 6001) / 100.0
    calm = 0.4 + np.random.default_rng(5).standard_normal(imu_t.size) * 1e-3
    shaken = calm + np.where((imu_t > 30.0) & (imu_t < 32.0), 5.0 * np.sin(40.0 * imu_t), 0.0)
    still = stationary_intervals(
        EDGES,
        ODOMETER_T,
        stop_between(20.0, 40.0),
        imu_t=imu_t,
        yaw_rate=shaken if channel == "yaw_rate" else calm,
        accelerations=(shaken,) if channel == "acceleration" else (calm,),
    )
    plain = stationary_intervals(EDGES, ODOMETER_T, stop_between(20.0, 40.0))
    ends = EDGES[1:][plain & ~still]
    assert ends[0] == pytest.approx(30.1)
    assert ends[-1] == pytest.approx(33.0, abs=0.11)


def test_a_constant_bias_is_no_motion():
    imu_t = np.arange(0, 601) / 10.0
    bias = np.full(imu_t.size, 0.02)
    plain = stationary_intervals(EDGES, ODOMETER_T, stop_between(20.0, 40.0))
    still = stationary_intervals(
        EDGES, ODOMETER_T, stop_between(20.0, 40.0), imu_t=imu_t, yaw_rate=bias
    )
    assert (still == plain).all()


def test_options_move_the_margins():
    wish = StationaryOptions(settle=5.0, max_speed=9.0)
    still = stationary_intervals(EDGES, ODOMETER_T, stop_between(0.0, 60.0), options=wish)
    assert EDGES[1:][still][0] == pytest.approx(5.1)
    assert stationary_intervals(EDGES, ODOMETER_T, stop_between(20, 21), options=wish)[
        100:500
    ].all()
