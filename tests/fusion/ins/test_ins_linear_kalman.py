"""Against a textbook Kalman filter in NumPy, on a car so close to its truth that all is linear."""

import numpy as np
import pytest
import scipy.linalg
import torch

from navlearn.attitude import quaternion_from_angles
from navlearn.frames import shift_geodetic
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import moved_belief, state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.mechanization.strapdown import strapdown_in_turn
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

RATE, SECONDS = 20, 6
SMALL = 1e-3  # everything a thousandth of its deviation: what is of second order is gone


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def accelerating_car():
    """Level and heading north, pushed forward by 2 m/s², its own truth by the strapdown."""
    count = RATE * SECONDS
    one = torch.ones(count, dtype=torch.float64)
    lat, zero = torch.tensor(0.0, dtype=torch.float64), torch.tensor(0.0, dtype=torch.float64)
    # on the equator no term of the level's turning is left but the Earth's rate to the north
    start = InsState(
        lat, zero, zero, torch.zeros(3).double(), quaternion_from_angles(zero, zero, zero)
    )
    omega = torch.tensor([0.0, 7.292115e-5, 0.0]).double().expand(count, 3)
    force = torch.tensor([0.0, 2.0, 9.7803253359]).double().expand(count, 3)
    samples = ImuSample(one / RATE, omega, force, one, 0.0 * one, 0.0 * one)
    return start, samples, strapdown_in_turn(start, samples)


def textbook(options, start_error, innovations):
    """KF on the error alone: φ-angle model of a level, north-bound car near the equator."""
    noise, n = options.noise, 15
    we, radius = 7.292115e-5, 6378137.0
    F = np.zeros((n, n))
    F[0:3, 3:6] = np.eye(3)
    F[5, 2] = 2 * 9.78 / radius
    F[3:6, 3:6] = -2 * skew([0, we, 0])
    F[3:6, 6:9] = -skew([0, 2.0, 9.7803253359])
    F[6, 4], F[7, 3] = 1 / 6335439.0, -1 / radius
    F[6:9, 6:9] = -skew([0, we, 0])
    F[3:6, 12:15] = -np.eye(3)
    F[6:9, 9:12] = -np.eye(3)
    Q = np.zeros((n, n))
    for k, walk in enumerate(
        (0.0, noise.accel_random_walk, noise.gyro_random_walk, noise.gyro_bias_walk,
         noise.accel_bias_walk)
    ):  # fmt: skip
        Q[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = walk**2 * np.eye(3)
    # Van Loan by scipy
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -F, Q, F.T
    e = scipy.linalg.expm(block)
    Phi = e[n:, n:].T
    Qd = Phi @ e[:n, n:]
    H = np.zeros((6, n))
    H[:6, :6] = np.eye(6)
    R = np.diag([1.0, 1.0, 4.0, 0.01, 0.01, 0.01])
    x, P = start_error.copy(), np.diag(options_sigmas(options) ** 2)
    found = []
    for z in innovations:
        x, P = Phi @ x, Phi @ P @ Phi.T + Qd
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (z - H @ x), (np.eye(n) - K @ H) @ P
        found.append((x, P))
    return found


def options_sigmas(options):
    start = options.initial
    return np.repeat(
        [start.position, start.velocity, start.tilt, start.gyro_bias, start.accel_bias], 3
    ) * np.array([1, 1, start.height / start.position] + [1] * 5
                 + [start.azimuth / start.tilt] + [1] * 6)  # fmt: skip


@pytest.mark.parametrize("method", ["sequential", "exact"])
@pytest.mark.parametrize("feedback", ["closed", "open"])
def test_equals_the_linear_kalman_filter(method, feedback):
    options = InsEkfOptions(
        feedback=feedback, odometer=False, nonholonomic=False, gate=GateOptions(probability=1.0)
    )
    start, samples, truth = accelerating_car()
    rng = np.random.default_rng(5)
    wrong = SMALL * options_sigmas(options) * rng.standard_normal(15)
    told = SMALL * rng.standard_normal((SECONDS, 6)) * np.array([1, 1, 2, 0.1, 0.1, 0.1])
    index = torch.arange(RATE - 1, RATE * SECONDS, RATE)
    at = InsState(*(x[index] for x in truth))
    lat, lon, height = shift_geodetic(*at[:3], *torch.from_numpy(told[:, :3].T.copy()))
    v = (at.v_l + torch.from_numpy(told[:, 3:])).unbind(-1)
    one = torch.ones(SECONDS, dtype=torch.float64)
    quiet = options.noise
    # deviations that with floor and inflation come to 1, 1, 2 m and 0.1 m/s
    std_e = (1.0 - quiet.position_floor**2) ** 0.5 / quiet.position_inflation
    std_u = (4.0 - quiet.height_floor**2) ** 0.5 / quiet.position_inflation
    std_v = (0.01 - quiet.velocity_floor**2) ** 0.5
    fixes = GnssFix(
        lat, lon, height, *v, std_e * one, std_e * one, std_u * one, std_v * one, one, one
    )
    belief = moved_belief(initial_ins_belief(options, start), torch.from_numpy(wrong))
    with torch.no_grad():
        history = InsEkf(options)(
            belief, samples, fixes, FixTiming(index, 0.0 * one), method=method
        )
    expected = textbook(options, wrong, told)
    error = torch.cat((state_difference(history.belief.state, at), history.belief.sensor), -1)
    for k, (x, P) in enumerate(expected):
        sigma = np.sqrt(np.diag(P))
        assert np.abs(error[k].numpy() - x).max() < 5e-4 * SMALL
        gap = (history.belief.covariance[k].numpy() - P) / np.outer(sigma, sigma)
        assert np.abs(gap).max() < 5e-3
