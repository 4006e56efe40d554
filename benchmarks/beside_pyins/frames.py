"""Samples, states and solutions turned from the frames of one package into the other's."""

from typing import NamedTuple

import numpy as np
import pandas as pd
import torch

from navlearn import attitude, earth
from navlearn.frames import enu_between
from navlearn.logs.synthetic import simulate_drive
from navlearn.states import ImuSample, InsState

TURN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Turns ENU to NED and RFU to FRD, and back."""

GYROS = ["gyro_x", "gyro_y", "gyro_z"]
ACCELS = ["accel_x", "accel_y", "accel_z"]
PVA = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
MISSING = "pyins is not installed: pip install git+https://github.com/nmayorov/pyins"


class Solution(NamedTuple):
    """A navigation solution at N times in the frames of this package, as arrays.

    Attributes:
        position: Latitude, longitude (rad) and height (m), shape (N, 3).
        v_l: Velocity, east, north, up, m/s, shape (N, 3).
        C_lb: Body RFU to ENU, shape (N, 3, 3).
    """

    position: np.ndarray
    v_l: np.ndarray
    C_lb: np.ndarray


def drive(seconds, seed, grade="ideal", rate=100.0, **more):
    """Return a simulated drive with the truth at t = 0 and at every IMU stamp."""
    return simulate_drive(
        profile="mixed",
        grade=grade,
        duration=float(seconds),
        seed=seed,
        imu_rate_hz=rate,
        reference_rate_hz=rate,
        **more,
    )


def states_of(table):
    """Return the rows of a reference table as states of shape (N,)."""
    column = {name: torch.tensor(table[name].to_numpy()) for name in table}
    q_lb = attitude.quaternion_from_angles(column["azimuth"], column["pitch"], column["roll"])
    v_l = torch.stack([column["v_e"], column["v_n"], column["v_u"]], -1)
    return InsState(column["lat"], column["lon"], column["height"], v_l, q_lb)


def solution_of(states):
    """Return states of shape (N,) as a solution."""
    return Solution(
        torch.stack(states[:3], -1).numpy(),
        states.v_l.numpy(),
        attitude.matrix_from_quaternion(states.q_lb).numpy(),
    )


def imu_sample(imu):
    """Return an IMU table, means over intervals from t = 0, as samples of shape (1, T)."""
    t = imu["t"].to_numpy()
    dt = torch.tensor(np.diff(t, prepend=0.0))[None]
    rate, force = (torch.tensor(imu[names].to_numpy())[None] for names in (GYROS, ACCELS))
    nothing = torch.zeros_like(dt)
    return ImuSample(dt, rate, force, nothing, nothing, nothing)


def difference(one, other):
    """Return position (m), velocity (m/s) and attitude φ (rad) of one minus other, (N, 3) each.

    φ is the rotation vector of C_one Cᵀ_other, east, north, up.
    """
    place = enu_between(*torch.tensor(one.position.T), *torch.tensor(other.position.T))
    turn = one.C_lb @ np.swapaxes(other.C_lb, -1, -2)
    pairs = ((2, 1), (0, 2), (1, 0))
    axis = 0.5 * np.stack([turn[:, i, j] - turn[:, j, i] for i, j in pairs], -1)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0))
    phi = axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)[:, None]
    return torch.stack(place, -1).numpy(), one.v_l - other.v_l, phi


def pyins_increments(imu):
    """Return an IMU table, means over intervals from t = 0, as increments of pyins."""
    from pyins.strapdown import compute_increments_from_imu

    t = imu["t"].to_numpy()
    sums = np.hstack([imu[GYROS].to_numpy() @ TURN, imu[ACCELS].to_numpy() @ TURN])
    sums = sums * np.diff(t, prepend=0.0)[:, None]
    # it wants what came before the first interval; the car stands
    table = np.vstack([sums[:1], sums])
    return compute_increments_from_imu(
        pd.DataFrame(table, index=np.append(0.0, t), columns=GYROS + ACCELS), "increment"
    )


def pyins_pva(solution, time):
    """Return the first place of a solution as position, velocity and attitude of pyins."""
    from pyins import transform

    place, C_nb = solution.position[0], TURN @ solution.C_lb[0] @ TURN
    values = [*np.rad2deg(place[:2]), place[2], *(TURN @ solution.v_l[0])]
    return pd.Series([*values, *transform.mat_to_rph(C_nb)], index=PVA, name=time)


def of_pyins(trajectory):
    """Return a trajectory of pyins as a solution."""
    from pyins import transform

    C_nb = transform.mat_from_rph(trajectory[PVA[6:]].to_numpy())
    place = trajectory[PVA[:3]].to_numpy() * np.array([np.pi / 180.0, np.pi / 180.0, 1.0])
    return Solution(place, trajectory[PVA[3:6]].to_numpy() @ TURN, TURN @ C_nb @ TURN)


def with_gravity_of_pyins(log):
    """Return the IMU table of a log as if gravity were that of pyins.

    It leaves out what flattening and the square of the height change about gravity aloft.
    """
    from pyins import earth as pyins_earth

    truth = solution_of(states_of(log.reference))
    lat, _, height = truth.position.T
    ours = earth.normal_gravity(torch.tensor(lat), torch.tensor(height)).numpy()
    more = (pyins_earth.gravity(np.rad2deg(lat), height) - ours)[:, None] * truth.C_lb[:, 2]
    imu = log.imu.copy()
    imu[ACCELS] += 0.5 * (more[1:] + more[:-1])
    return imu
