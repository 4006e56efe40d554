"""The prediction of one sample, scriptable: strapdown, dynamics, Φ P Φᵀ + Q."""

import torch
from torch import Tensor

from navlearn.filters.ekf import propagated
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.dahmane2022 import dahmane2022_dynamics
from navlearn.fusion.ins.error_dynamics import motion_between, phi_angle_dynamics, with_sensors
from navlearn.fusion.ins.imu_errors import SensorStates, errors_of, imu_corrected
from navlearn.fusion.ins.linear_steps import density_of, discretized
from navlearn.mechanization.coning import coning_sculling_step
from navlearn.mechanization.strapdown import local_level_step
from navlearn.states import ImuSample


def sample_step(
    belief: InsBelief,
    sample: ImuSample,
    has: SensorStates,
    simple: bool,
    tau: float,
    white: Tensor,
    walks: Tensor,
) -> tuple[InsBelief, Tensor]:
    """Return the belief after one interval, and the transition over it.

    Args:
        belief: Belief before it, batch shape (...).
        sample: The sample, shape (...) each.
        has: Which sensor errors are states.
        simple: Whether the dynamics are those of [Dahmane2022].
        tau: Correlation time of the biases, s; infinite for random walks.
        white: Angle random walk (rad/√s), velocity random walk (m/s/√s) and turn noise (√s),
            shape (3,).
        walks: Random walk of each sensor parameter, shape (m,).

    Returns:
        Belief and Φ, shape (..., n, n).
    """
    errors = errors_of(belief.sensor, has)
    omega, force = imu_corrected(errors, sample.omega_ib_b, sample.f_b)
    rotation, velocity = coning_sculling_step(omega, force, sample.dt)
    state = local_level_step(belief.state, rotation, velocity, sample.dt)
    motion = motion_between(belief.state, state, omega, force)
    core = dahmane2022_dynamics(motion) if simple else phi_angle_dynamics(motion)
    F = with_sensors(core, motion, errors, has, tau)
    transition, noise = discretized(F, density_of(omega, white, walks), sample.dt)
    sensor = decayed(belief.sensor, has, tau, sample.dt)
    covariance = propagated(belief.covariance, transition, noise)
    return InsBelief(state, sensor, covariance, belief.refused), transition


def decayed(sensor: Tensor, has: SensorStates, tau: float, dt: Tensor) -> Tensor:
    """Return sensor parameters after an interval: Gauss–Markov biases decay, the others stay.

    Args:
        sensor: Sensor parameters, shape (..., m).
        has: Which sensor errors are states.
        tau: Correlation time of the biases, s; infinite for random walks.
        dt: Length of the interval, s, shape (...).

    Returns:
        Sensor parameters, shape (..., m).
    """
    if not has.bias or tau == float("inf"):
        return sensor
    left = torch.exp(-dt / tau).unsqueeze(-1)
    return torch.cat((sensor[..., :6] * left, sensor[..., 6:]), -1)
