"""The simulated scenario of [Jaradat2017] §IV.

Specific force and angular rate are linear in time, the truth is their strapdown solution in
the Earth-fixed frame (5)–(11), biases are random walks (22)–(23), fixes carry 2 m of white
noise, and four are missed: 50 Hz and 5 Hz. The paper prints none of the other figures: length,
profiles and noise densities below are this package's. Its (5) wants gravitation; here normal
gravity, which holds the centrifugal term, stands for G − Ω²P.
"""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from navlearn import attitude, earth, frames, wgs84
from navlearn.logs.drive_log import DriveLog, StatedStart
from navlearn.logs.synthetic.aiding import fix_table, local_gravity, reference_table
from navlearn.logs.synthetic.draws import Array, generator
from navlearn.logs.synthetic.figures import (
    AccelerometerGrade,
    GnssGrade,
    GyroGrade,
    SensorGrade,
)
from navlearn.logs.synthetic.grades import find_grade
from navlearn.logs.synthetic.inertial_errors import accelerometer_errors, gyro_errors
from navlearn.logs.synthetic.inverse import Truth
from navlearn.logs.synthetic.log_parts import START_TEMPERATURE, describe, imu_table
from navlearn.logs.synthetic.motion import Kinematics
from navlearn.logs.synthetic.simulate import ORIGIN
from navlearn.logs.synthetic.simulated_drive import SimulatedDrive

DURATION = 100.0
"""s."""

IMU_RATE_HZ = 50.0
FIX_RATE_HZ = 5.0
MISSED_FIXES = 4

START_AZIMUTH = 0.5
"""rad; the vehicle starts level."""

START_SPEED = 5.0
"""Along the forward axis, m/s."""

FORCE = np.array(((0.3, -0.006), (0.6, -0.01), (0.05, -0.001)))
"""Specific force beside gravity: value at t = 0 (m/s²) and slope (m/s³) along x, y, z."""

RATE = np.array(((4e-4, -8e-6), (-4e-4, 8e-6), (0.03, -6e-4)))
"""Angular rate: value at t = 0 (rad/s) and slope (rad/s²) about x, y, z."""

GRADE = SensorGrade(
    name="jaradat2017",
    summary="white noise and random-walk biases of [Jaradat2017] (6), (12), (22), (23)",
    gyro=GyroGrade(
        rate_random_walk_deg_per_h_per_sqrt_h=300.0, angle_random_walk_deg_per_sqrt_h=0.6
    ),
    accelerometer=AccelerometerGrade(
        random_walk_mg_per_sqrt_h=20.0, velocity_random_walk_m_per_s_per_sqrt_h=0.1
    ),
    gnss=GnssGrade(noise=2.0, vertical_factor=1.0),
)
"""Figures of the scenario's sensors."""


def jaradat2017_scenario(seed: int = 0) -> SimulatedDrive:
    """Return the scenario of [Jaradat2017] §IV.

    The paper has no odometer: the log's is the true speed along the forward axis at 5 Hz.

    Args:
        seed: Seed of every draw, not negative.
    """
    dt = 1.0 / IMU_RATE_HZ
    t = np.arange(1, round(DURATION * IMU_RATE_HZ) + 1) / IMU_RATE_HZ
    # The mean of a linear function is its value in the middle of the interval.
    force, rate = profiles(t - 0.5 * dt)
    warm = np.zeros_like(t)
    gyros = gyro_errors(rate, force, warm, dt, grade=GRADE.gyro, seed=seed)
    accels = accelerometer_errors(force, warm, dt, grade=GRADE.accelerometer, seed=seed)
    read_rate = [e.apply(rate[:, i]) for i, e in enumerate(gyros)]
    read_force = [e.apply(force[:, i]) for i, e in enumerate(accels)]
    steady = np.full_like(t, START_TEMPERATURE)
    truth = strapdown_truth(np.append(0.0, t))
    return SimulatedDrive(
        log=_log(GRADE, truth, imu_table(t, read_rate, read_force, steady), seed),
        ideal=_log(
            find_grade("ideal"), truth, imu_table(t, list(rate.T), list(force.T), steady), seed
        ),
        gyro_errors=gyros[2],
        motion=None,
        grade=GRADE,
        seed=seed,
    )


def profiles(t: Array) -> tuple[Array, Array]:
    """Return specific force (m/s²) and angular rate (rad/s) in the body frame, shape (N, 3) each.

    Args:
        t: Times, s, shape (N,).
    """
    force = FORCE[:, 0] + t[:, None] * FORCE[:, 1]
    force[:, 2] += local_gravity(ORIGIN[0], ORIGIN[2])
    return force, RATE[:, 0] + t[:, None] * RATE[:, 1]


def strapdown_truth(t: Array) -> Truth:
    """Return where the profiles lead, by an adaptive integrator to 1e-7 m.

    [Jaradat2017] Eqs. (5)–(11).

    Args:
        t: Times from 0 to :data:`DURATION`, increasing, s, shape (N,).
    """
    solution = solve_ivp(
        _derivative, (0.0, DURATION), _start(), method="DOP853", t_eval=t, rtol=1e-12, atol=1e-9
    )
    state = torch.from_numpy(np.array(solution.y.T))
    lat, lon, height = frames.geodetic_from_ecef(state[:, :3])
    c_le = frames.enu_from_ecef_matrix(lat, lon)
    v_l = torch.einsum("nij,nj->ni", c_le, state[:, 3:6])
    q = state[:, 6:] / torch.linalg.vector_norm(state[:, 6:], dim=-1, keepdim=True)
    c_lb = c_le @ attitude.matrix_from_quaternion(q)
    azimuth, pitch, roll = (a.numpy() for a in attitude.angles_from_matrix(c_lb))
    forward = torch.einsum("ni,ni->n", c_lb[:, :, 1], v_l).numpy()
    none = np.zeros_like(t)
    return Truth(
        t=t,
        lat=lat.numpy(),
        lon=lon.numpy(),
        height=height.numpy(),
        v_l=v_l.numpy(),
        kinematics=Kinematics(forward, none, azimuth, none, pitch, none, roll, none),
    )


def _start() -> Array:
    lat, lon, height = (torch.tensor(x, dtype=torch.float64) for x in ORIGIN)
    azimuth, level = torch.tensor(START_AZIMUTH, dtype=torch.float64), torch.zeros(())
    c_el = frames.enu_from_ecef_matrix(lat, lon).T
    c_eb = c_el @ attitude.matrix_from_angles(azimuth, level.double(), level.double())
    position = frames.ecef_from_geodetic(lat, lon, height).numpy()
    # scipy keeps the scalar last, this package first.
    q = Rotation.from_matrix(c_eb.numpy()).as_quat()
    return np.concatenate((position, c_eb.numpy()[:, 1] * START_SPEED, q[3:], q[:3]))


def _derivative(t: float, state: Array) -> Array:
    position, v, q = state[:3], state[3:6], state[6:]
    lat, lon, height = frames.geodetic_from_ecef(torch.from_numpy(position))
    up = frames.enu_from_ecef_matrix(lat, lon)[2].numpy()
    force, rate = (x[0] for x in profiles(np.array((t,))))
    c_eb = attitude.matrix_from_quaternion(torch.from_numpy(q / np.linalg.norm(q))).numpy()
    earth_rate = np.array((0.0, 0.0, wgs84.EARTH_RATE))
    gravity = -float(earth.normal_gravity(lat, height)) * up
    v_dot = c_eb @ force - 2.0 * np.cross(earth_rate, v) + gravity
    x, y, z = rate - c_eb.T @ earth_rate
    turn = np.array(((0.0, -x, -y, -z), (x, 0.0, z, -y), (y, -z, 0.0, x), (z, y, -x, 0.0)))
    return np.concatenate((v, v_dot, 0.5 * turn @ q))


def _log(grade: SensorGrade, truth: Truth, imu: pd.DataFrame, seed: int) -> DriveLog:
    at_fix, arm = truth.pick(round(IMU_RATE_HZ / FIX_RATE_HZ)), (0.0, 0.0, 0.0)
    # Neither near the start nor near the end: there is a fix on both sides.
    missed = generator(seed, "gnss/missed").choice(
        np.arange(10, at_fix.t.size - 10), size=MISSED_FIXES, replace=False
    )
    fixes = fix_table(at_fix.t, at_fix, grade=grade.gnss, lever_arm=arm, seed=seed)
    fixes = fixes.drop(columns=["v_e", "v_n", "v_u", "std_v"]).drop(index=missed.tolist())
    source = "navlearn simulator: scenario of [Jaradat2017] §IV"
    about = describe(f"jaradat2017_{grade.name}_{seed}", source, grade, "jaradat2017", seed, arm)
    sensors = {**about.sensors, "odometer": "exact; the paper has none"}
    return DriveLog(
        imu=imu,
        odometer=pd.DataFrame({"t": at_fix.t, "speed": at_fix.kinematics.speed}),
        fixes=fixes.reset_index(drop=True),
        reference=reference_table(truth),
        metadata=replace(about, sensors=sensors, start=_stated_start()),
    )


def _stated_start() -> StatedStart:
    """Return the start, which the paper takes for known: its fixes tell no velocity to align by."""
    lat, lon, height = ORIGIN
    return StatedStart(
        lat=lat,
        lon=lon,
        height=height,
        v_e=START_SPEED * math.sin(START_AZIMUTH),
        v_n=START_SPEED * math.cos(START_AZIMUTH),
        v_u=0.0,
        azimuth=START_AZIMUTH,
        pitch=0.0,
        roll=0.0,
    )
