"""Error-free sensors against independent mathematics: an adaptive integrator, the inertial frame,
and the RISS mechanization.
"""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from navlearn import earth, frames, wgs84
from navlearn.logs.synthetic import SimulatedDrive, simulate_drive
from navlearn.logs.synthetic.inverse import (
    cumulative,
    grid_stride,
    ideal_inertial,
    integrate,
    interval_means,
    truth_at,
)
from navlearn.logs.synthetic.motion import Motion
from navlearn.logs.synthetic.profile import draw_motion
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import NavState, RissSample

Array = NDArray[np.float64]
ORIGIN = (math.radians(57.0), math.radians(10.0), 40.0)


@pytest.fixture(scope="module")
def hills() -> Motion:
    return draw_motion("hills", duration=300.0, seed=2, standstill=5.0)


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    return simulate_drive(grade="ideal", duration=1200.0, seed=5, reference_rate_hz=100.0)


def ellipsoid_rates(motion: Motion, t: float, state: Array) -> list[float]:
    """Position rates written out with textbook radii, independent of navlearn.earth."""
    k = motion.at(np.array([t]))
    v = float(k.speed[0])
    e2 = (2.0 - 1.0 / 298.257223563) / 298.257223563
    w = 1.0 - e2 * math.sin(state[0]) ** 2
    r_n = 6378137.0 / math.sqrt(w)
    r_m = r_n * (1.0 - e2) / w
    cp = math.cos(float(k.pitch[0]))
    north, east = v * math.cos(k.azimuth[0]) * cp, v * math.sin(k.azimuth[0]) * cp
    return [
        north / (r_m + state[2]),
        east / ((r_n + state[2]) * math.cos(state[0])),
        v * math.sin(float(k.pitch[0])),
    ]


def test_truth_equals_an_adaptive_integrator(hills: Motion) -> None:
    oracle = solve_ivp(
        lambda t, y: ellipsoid_rates(hills, t, y),
        (0.0, 100.0),
        ORIGIN,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        max_step=0.25,
    ).y[:, -1]
    truth = integrate(hills, ORIGIN, np.arange(20001) / 200.0)
    assert abs(truth.lat[-1] - oracle[0]) * 6.4e6 < 1e-5
    assert abs(truth.lon[-1] - oracle[1]) * 6.4e6 < 1e-5
    assert abs(truth.height[-1] - oracle[2]) < 1e-5
    assert abs(truth.lat[-1] - ORIGIN[0]) * 6.4e6 > 100.0


def test_end_corrected_trapezoid_is_of_fourth_order() -> None:
    def error(n: int) -> float:
        t = np.linspace(0.0, 3.0, n + 1)
        return abs(float(cumulative(np.cos(t), -np.sin(t), 3.0 / n)[-1]) - math.sin(3.0))

    assert error(40) < 1e-6
    assert error(20) / error(40) == pytest.approx(16.0, rel=0.1)


def inertial_position(truth_lat: Array, truth_lon: Array, height: Array, t: Array) -> Array:
    ecef = frames.ecef_from_geodetic(*(torch.tensor(a) for a in (truth_lat, truth_lon, height)))
    return Rotation.from_euler("z", wgs84.EARTH_RATE * t[:, None]).apply(ecef.numpy())


def test_sensors_equal_derivatives_in_the_inertial_frame(hills: Motion) -> None:
    """No Coriolis term, no transport rate: positions and attitudes are differenced inertially."""
    grid = integrate(hills, ORIGIN, np.arange(60001) / 200.0)
    middle = np.linspace(10.0, 290.0, 57)
    step = 0.02

    def attitude(t: Array) -> Rotation:
        truth, k = truth_at(grid, hills, t), hills.at(t)
        c_lb = Rotation.from_euler("ZXY", np.stack((-k.azimuth, k.pitch, k.roll), -1))
        # East-north-up to Earth-fixed, by two elementary turns.
        c_el = Rotation.from_euler(
            "ZX", np.stack((truth.lon + math.pi / 2, math.pi / 2 - truth.lat), -1)
        )
        return Rotation.from_euler("z", wgs84.EARTH_RATE * t[:, None]) * c_el * c_lb

    def position(t: Array) -> Array:
        truth = truth_at(grid, hills, t)
        return inertial_position(truth.lat, truth.lon, truth.height, t)

    def rate_by_difference(h: float) -> Array:
        turned = attitude(middle - h).inv() * attitude(middle + h)
        return turned.as_rotvec() / (2.0 * h)

    def acceleration_by_difference(h: float) -> Array:
        return (position(middle + h) - 2.0 * position(middle) + position(middle - h)) / h**2

    # Richardson: the error of the central differences falls from h² to h⁴.
    rate = (4.0 * rate_by_difference(step / 2) - rate_by_difference(step)) / 3.0
    acceleration = (
        4.0 * acceleration_by_difference(step) - acceleration_by_difference(2.0 * step)
    ) / 3.0
    truth = truth_at(grid, hills, middle)
    p = position(middle)
    gravity = earth.normal_gravity(torch.tensor(truth.lat), torch.tensor(truth.height)).numpy()
    up = np.stack(
        (
            np.cos(truth.lat) * np.cos(truth.lon + wgs84.EARTH_RATE * middle),
            np.cos(truth.lat) * np.sin(truth.lon + wgs84.EARTH_RATE * middle),
            np.sin(truth.lat),
        ),
        axis=-1,
    )
    centrifugal = wgs84.EARTH_RATE**2 * p * np.array((1.0, 1.0, 0.0))
    force = attitude(middle).inv().apply(acceleration + centrifugal + gravity[:, None] * up)
    found_rate, found_force = ideal_inertial(truth)
    np.testing.assert_allclose(found_rate, rate, atol=2e-8)
    np.testing.assert_allclose(found_force, force, atol=2e-5)


def test_parked_car_senses_gravity_and_earth_rate() -> None:
    drive = simulate_drive(grade="ideal", profile="town", duration=20.0, standstill=15.0, seed=4)
    parked = drive.ideal.imu[drive.ideal.imu["t"] < 10.0]
    lat = torch.tensor(0.7719591)
    assert np.hypot(
        np.hypot(parked["accel_x"], parked["accel_y"]), parked["accel_z"]
    ).to_numpy() == pytest.approx(float(earth.normal_gravity(lat, torch.tensor(60.0))), abs=1e-5)
    total = np.hypot(np.hypot(parked["gyro_x"], parked["gyro_y"]), parked["gyro_z"]).to_numpy()
    assert total == pytest.approx(wgs84.EARTH_RATE, rel=1e-9)
    fixes = drive.ideal.fixes
    assert fixes["lat"].to_numpy()[:10] == pytest.approx(0.7719591, abs=1e-6)


def test_interval_means_are_exact_for_cubics() -> None:
    t = np.arange(41) / 40.0
    stride = 4
    found = interval_means(np.stack((t**3, 1.0 - t), -1), stride)
    edges = t[::stride]
    exact = np.diff(edges**4) / 4.0 / np.diff(edges)
    np.testing.assert_allclose(found[:, 0], exact, rtol=1e-12)
    np.testing.assert_allclose(found[:, 1], 1.0 - 0.5 * (edges[1:] + edges[:-1]), rtol=1e-12)


@pytest.mark.parametrize("rate", [1.0, 10.0, 62.5, 100.0, 104.0, 400.0])
def test_grid_is_fine_and_even(rate: float) -> None:
    stride = grid_stride(rate)
    assert stride % 2 == 0
    assert stride * rate >= 200.0


def test_positions_between_grid_points(hills: Motion) -> None:
    coarse = integrate(hills, ORIGIN, np.arange(60001) / 200.0)
    fine = integrate(hills, ORIGIN, np.arange(200001) / 2000.0)
    between = np.arange(7, 200000, 997)
    found = truth_at(coarse, hills, fine.t[between])
    assert np.abs(found.lat - fine.lat[between]).max() * 6.4e6 < 1e-6
    assert np.abs(found.lon - fine.lon[between]).max() * 6.4e6 < 1e-6
    assert np.abs(found.height - fine.height[between]).max() < 1e-6


def tensor(values: Array) -> torch.Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float64))


def riss_error(drive: SimulatedDrive, yaw_rate: Array) -> Array:
    """Horizontal error of RISS fed with true speed and tilt, m."""
    truth, motion = drive.ideal.reference, drive.motion
    assert truth is not None
    assert motion is not None
    middle = motion.at(drive.ideal.imu["t"].to_numpy() - 0.005)
    none = torch.zeros(yaw_rate.size, dtype=torch.float64)
    samples = RissSample(
        dt=none + 0.01,
        yaw_rate=tensor(yaw_rate),
        speed=tensor(middle.speed),
        pitch=tensor(middle.pitch),
        roll=tensor(middle.roll),
        f_x=none,
        f_y=none,
        stationary=none,
    )
    first = [torch.tensor(truth[c].iloc[0]) for c in ("lat", "lon", "height", "azimuth")]
    found = riss_over_time(NavState(*first), samples)
    north = (found.lat.numpy() - truth["lat"].to_numpy()[1:]) * 6.37e6
    east = (found.lon.numpy() - truth["lon"].to_numpy()[1:]) * 6.37e6
    return np.hypot(east * math.cos(float(first[0])), north)


def test_riss_reproduces_truth_from_the_gyro_less_its_two_further_terms(
    drive: SimulatedDrive,
) -> None:
    """Without the pitch rate in roll and the horizontal Earth rate in tilt, RISS is exact."""
    imu, truth, motion = drive.ideal.imu, drive.ideal.reference, drive.motion
    assert truth is not None
    assert motion is not None
    t = imu["t"].to_numpy() - 0.005
    k = motion.at(t)
    lat, height = (np.interp(t, truth["t"], truth[c]) for c in ("lat", "height"))
    v_e = k.speed * np.sin(k.azimuth) * np.cos(k.pitch)
    v_n = k.speed * np.cos(k.azimuth) * np.cos(k.pitch)
    east = -v_n / (6.3781e6 * (1 - 0.0067 + 0.01 * np.sin(lat) ** 2) + height)
    north = wgs84.EARTH_RATE * np.cos(lat) + v_e / (6.38e6 + height)
    sa, ca, sr, cr = np.sin(k.azimuth), np.cos(k.azimuth), np.sin(k.roll), np.cos(k.roll)
    sp = np.sin(k.pitch)
    tilted = east * (ca * sr - sa * sp * cr) + north * (-sa * sr - ca * sp * cr)
    further = k.pitch_rate * sr + tilted
    error = riss_error(drive, imu["gyro_z"].to_numpy() - further)
    assert error.max() < 0.05


def test_riss_from_ideal_sensors_stays_near_truth(drive: SimulatedDrive) -> None:
    """The full gyro's further terms cost RISS some metres over 20 minutes and 17 km."""
    error = riss_error(drive, drive.ideal.imu["gyro_z"].to_numpy())
    assert error.max() < 10.0
    assert error[:6000].max() < 0.1
