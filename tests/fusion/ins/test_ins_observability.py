"""What the full-IMU filter observes, by its own Φ and its own covariance, against linear theory."""

import numpy as np
import pytest
import torch

from navlearn.attitude import quaternion_from_angles
from navlearn.filters.degree_of_observability import (
    degree_of_observability,
    main_components,
    normalized_covariance,
)
from navlearn.filters.observability import (
    hidden_parts,
    left_of_states,
    observability_matrix,
    observability_rank,
)
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.fusion.ins.smoothing import smooth_ins
from navlearn.fusion.ins.start import initial_ins_belief, initial_ins_sigmas
from navlearn.fusion.smoothing import SmoothingOptions
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.motion import Motion, uniform_spline
from navlearn.states import InsState

OPTIONS = InsEkfOptions(
    odometer=False, nonholonomic=False, zero_velocity=False, zero_angular_rate=False,
    initial=InsInitialOptions(
        position=3.0, height=5.0, velocity=0.5, tilt=0.02, azimuth=0.1, gyro_bias=3e-3,
        accel_bias=0.08,
    ),
    noise=InsNoiseOptions(
        gyro_random_walk=2e-4, accel_random_walk=0.01, turn_noise=0.01, gyro_bias_walk=5e-6,
        accel_bias_walk=3e-4,
    ),
)  # fmt: skip
END = 150.0


def motion() -> Motion:
    """At rest for 40 s, off to 15 m/s, steady, slower at 95 s and faster again, curves from 120."""

    def speed(t: np.ndarray) -> np.ndarray:
        return np.interp(
            t, [40.0, 47.0, 95.0, 101.0, 104.0, 110.0], [0.0, 15.0, 15.0, 6.0, 6.0, 15.0]
        )

    def azimuth(t: np.ndarray) -> np.ndarray:
        return 0.3 * (1.0 - np.cos(0.5 * np.clip(t - 120.0, 0.0, 4.0 * np.pi)))

    def level(s: np.ndarray) -> np.ndarray:
        return 0.0 * s

    return Motion(
        duration=END,
        speed=uniform_spline(speed, END, 0.5),
        azimuth=uniform_spline(azimuth, END, 0.5),
        slope=uniform_spline(level, 3000.0, 10.0),
        crossfall=uniform_spline(level, 3000.0, 10.0),
    )


def filtered(grade: str):
    log = simulate_drive(profile=motion(), grade=grade, seed=12, imu_rate_hz=10.0).log
    line = imu_timeline(log)
    place = (
        torch.tensor(float(log.reference[x].iloc[0])).double() for x in ("lat", "lon", "height")
    )
    zero = torch.zeros((), dtype=torch.float64)
    start = InsState(*place, torch.zeros(3).double(), quaternion_from_angles(zero, zero, zero))
    ekf, belief = InsEkf(OPTIONS), initial_ins_belief(OPTIONS, start)
    with torch.no_grad():
        history = ekf(belief, line.samples, line.fixes, line.timing)
    return ekf, belief, line, history


@pytest.fixture(scope="module")
def windows():
    """Φ of every block of an error-free drive, and when blocks end."""
    ekf, belief, line, history = filtered("ideal")
    with torch.no_grad():
        found = smooth_ins(
            ekf, belief, line.samples, line.fixes, line.timing, history, SmoothingOptions(passes=1)
        )
    return ekf.model.layout.names, line.t[history.end], found.transition


@pytest.mark.parametrize(
    ("start", "end", "rank"), [(2, 38, 12), (52, 92, 12), (70, 116, 14), (112, 140, 15)]
)
def test_the_filters_own_linearisation_has_the_ranks_of_theory(windows, start, end, rank) -> None:
    """At rest, at constant velocity, slower and faster on a straight road, into curves."""
    names, t, transition = windows
    inside = (t > start) & (t <= end)
    phi = transition[inside]
    H = torch.eye(15, dtype=torch.float64)[:6].expand(phi.shape[0], -1, -1)
    noise = torch.tensor([2.0] * 3 + [0.1] * 3, dtype=torch.float64)
    matrix = observability_matrix(phi, H)
    # the simulated drive is as straight as an ellipsoid allows
    found = observability_rank(matrix, initial_ins_sigmas(OPTIONS), noise=noise, tolerance=3e-6)
    assert int(found.rank) == rank
    parts = dict(zip(names, hidden_parts(found).tolist(), strict=True))
    left = dict(zip(names, left_of_states(found).tolist(), strict=True))
    if rank == 12:
        assert parts["phi_up"] == pytest.approx(1.0, abs=1e-3)
        assert parts["accel_bias_x"] > 0.5
        assert parts["accel_bias_y"] > 0.5
    if rank == 14:  # roll on a road to the north, and the accelerometer that cannot tell it
        assert parts["phi_north"] + parts["accel_bias_x"] == pytest.approx(1.0, abs=1e-3)
        assert left["phi_up"] < 0.8
    if rank == 15:
        assert left["accel_bias_x"] < 0.5
        assert left["phi_up"] < 0.5


def test_the_filters_covariance_says_the_same_of_a_noisy_drive() -> None:
    ekf, belief, line, history = filtered("mems_m")
    names, t = ekf.model.layout.names, line.t[history.end]
    normalized = normalized_covariance(history.belief.covariance, belief.covariance)
    degree = degree_of_observability(normalized)
    left = normalized.against_start.diagonal(dim1=-2, dim2=-1).sqrt()

    def at(time: float, name: str) -> float:
        return float(left[int((t <= time).sum()) - 1, names.index(name)])

    def least(time: float) -> str:
        k = int((t <= time).sum()) - 1
        return main_components(degree.directions[k, :, -1], names)[0][0]

    # azimuth drifts at rest, is told by speeding up, fades at constant velocity
    assert at(38.0, "phi_up") > 1.0
    assert least(38.0) == "phi_up"
    assert at(50.0, "phi_up") < 0.15
    assert at(94.0, "phi_up") > 2.0 * at(50.0, "phi_up")
    # straight on, the forward accelerometer parts from pitch, the transversal one only in curves
    assert at(112.0, "accel_bias_y") < 0.7 * at(112.0, "accel_bias_x")
    assert least(118.0) == "accel_bias_x"
    assert at(145.0, "accel_bias_x") < 0.7 * at(118.0, "accel_bias_x")
    assert at(145.0, "phi_north") < 0.7 * at(118.0, "phi_north")
