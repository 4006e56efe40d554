"""The scenario of [Jaradat2017] §IV: rates, noise, missed fixes, and a truth that its own
sensors lead to.
"""

import math

import numpy as np
import pytest
import torch

from navlearn import attitude, earth
from navlearn.logs.synthetic import SimulatedDrive, jaradat2017_scenario
from navlearn.logs.synthetic.jaradat2017 import GRADE, profiles
from navlearn.logs.validate import validate_log


@pytest.fixture(scope="module")
def scenario() -> SimulatedDrive:
    return jaradat2017_scenario(seed=1)


def test_rates_and_missed_fixes(scenario: SimulatedDrive) -> None:
    log = validate_log(scenario.log)
    assert np.diff(log.imu["t"]) == pytest.approx(0.02)
    steps = np.diff(log.fixes["t"])
    assert np.median(steps) == pytest.approx(0.2)
    assert len(log.fixes) == 501 - 4
    assert round(float(np.sum(steps / 0.2 - 1.0))) == 4
    assert "v_e" not in log.fixes
    assert not scenario.gyro_deterministic_error.any()


def test_profiles_are_linear() -> None:
    force, rate = profiles(np.arange(0.0, 101.0))
    assert np.abs(np.diff(force, n=2, axis=0)).max() < 1e-12
    assert np.abs(np.diff(rate, n=2, axis=0)).max() < 1e-15
    assert np.abs(np.diff(force, axis=0)).min(axis=0).min() > 0.0


def test_the_path_has_three_dimensions(scenario: SimulatedDrive) -> None:
    truth = scenario.log.reference
    assert truth is not None
    assert np.ptp(truth["lat"]) * 6.4e6 > 500.0
    assert np.ptp(truth["lon"]) * 6.4e6 * math.cos(0.77) > 200.0
    assert np.ptp(truth["height"]) > 50.0


def test_local_level_strapdown_from_the_ideal_sensors_meets_the_truth(
    scenario: SimulatedDrive,
) -> None:
    """A second mechanization in other axes: 50 Hz increments in east, north, up."""
    truth, imu = scenario.ideal.reference, scenario.ideal.imu[:2000]
    assert truth is not None
    first = truth.iloc[0]
    lat, lon, h = (torch.tensor(first[c], dtype=torch.float64) for c in ("lat", "lon", "height"))
    v = torch.tensor(first[["v_e", "v_n", "v_u"]].to_numpy(dtype=float))
    c_lb = attitude.matrix_from_angles(
        *(torch.tensor(first[c], dtype=torch.float64) for c in ("azimuth", "pitch", "roll"))
    )
    dt = 0.02
    rates = torch.tensor(imu[["gyro_x", "gyro_y", "gyro_z"]].to_numpy())
    forces = torch.tensor(imu[["accel_x", "accel_y", "accel_z"]].to_numpy())
    for rate, force in zip(rates, forces, strict=True):
        omega_ie = earth.earth_rate_enu(lat)
        omega_el = earth.transport_rate_enu(lat, h, v[0], v[1])
        turn = rate - c_lb.T @ (omega_ie + omega_el)
        half, full = (
            attitude.matrix_from_quaternion(attitude.quaternion_from_rotation_vector(turn * s))
            for s in (0.5 * dt, dt)
        )
        gravity = torch.stack((v[0] * 0, v[0] * 0, -earth.normal_gravity(lat, h)))
        coriolis = torch.linalg.cross(2.0 * omega_ie + omega_el, v)
        new = v + dt * (c_lb @ half @ force + gravity - coriolis)
        mean = 0.5 * (v + new)
        lat = lat + dt * mean[1] / (earth.meridian_radius(lat) + h)
        lon = lon + dt * mean[0] / ((earth.prime_vertical_radius(lat) + h) * torch.cos(lat))
        h, v, c_lb = h + dt * mean[2], new, c_lb @ full
    last = truth.iloc[2000]
    assert abs(float(lat) - last["lat"]) * 6.4e6 < 0.05
    assert abs(float(lon) - last["lon"]) * 6.4e6 * math.cos(last["lat"]) < 0.05
    assert abs(float(h) - last["height"]) < 0.05
    azimuth = attitude.angles_from_matrix(c_lb)[0]
    assert abs(float(azimuth) - last["azimuth"]) < 1e-6


def test_fix_noise_is_two_metres_white(scenario: SimulatedDrive) -> None:
    fixes, truth = scenario.log.fixes, scenario.log.reference
    assert truth is not None
    lat, lon, height = (
        (fixes[c] - np.interp(fixes["t"], truth["t"], truth[c])).to_numpy()
        for c in ("lat", "lon", "height")
    )
    errors = np.stack((lat * 6.367e6, lon * 6.387e6 * math.cos(0.772), height))
    assert np.std(errors, axis=1) == pytest.approx(2.0, rel=0.1)
    assert np.abs(np.mean(errors[:, 1:] * errors[:, :-1], axis=1)).max() < 0.6


def test_biases_walk(scenario: SimulatedDrive) -> None:
    walk = scenario.gyro_errors.stochastic["random_walk"]
    figure = GRADE.gyro.rate_random_walk_deg_per_h_per_sqrt_h
    step = math.radians(figure) / 3600.0 / 60.0 * math.sqrt(0.02)
    assert np.std(np.diff(walk)) == pytest.approx(step, rel=0.05)
    assert not scenario.gyro_errors.stochastic["gauss_markov"].any()


def test_seeds(scenario: SimulatedDrive) -> None:
    again, other = jaradat2017_scenario(1), jaradat2017_scenario(2)
    assert again.log.imu.equals(scenario.log.imu)
    assert again.log.fixes.equals(scenario.log.fixes)
    assert not other.log.fixes["t"].equals(scenario.log.fixes["t"])


def test_the_stated_start_is_where_the_truth_begins(scenario: SimulatedDrive) -> None:
    start, truth = scenario.log.metadata.start, scenario.log.reference
    assert start is not None
    assert truth is not None
    first = truth.iloc[0]
    assert first["t"] == 0.0
    for name in ("lat", "lon", "height", "v_e", "v_n", "v_u", "azimuth", "pitch", "roll"):
        assert getattr(start, name) == pytest.approx(first[name], abs=1e-8), name
