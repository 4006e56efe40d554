"""Both filters run on the same work, and their errors and covariances in the same terms."""

import math
import time
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from scipy.spatial.transform import Rotation

from beside_pyins import frames
from beside_pyins.work import LEVER_ARM
from navlearn.filters.consistency import nees
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.states import FixTiming, GnssFix, InsState

BLOCKS = {
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "attitude": slice(6, 9),
    "biases": slice(9, 15),
    "all 15": slice(0, 15),
}


class Found(NamedTuple):
    """What a filter found at S whole seconds, after the update there; not at the last.

    Attributes:
        index: Samples at whose ends these seconds fall, shape (S,).
        state: Estimates, shape (B, S).
        bias: Estimated biases, gyros then accelerometers, shape (B, S, 6).
        covariance: Of the errors, in the order and signs of this package, (B, S, 15, 15).
        inside: Estimates at every sample, shape (B, T).
        spent: CPU seconds.
    """

    index: torch.Tensor
    state: InsState
    bias: torch.Tensor
    covariance: torch.Tensor
    inside: InsState
    spent: float


def options(told):
    """Return the options of a filter that has the states of pyins and is told the same."""
    return InsEkfOptions(
        states=15,
        odometer=False,
        nonholonomic=False,
        zero_velocity=False,
        zero_angular_rate=False,
        lever_arm=LEVER_ARM,
        noise=InsNoiseOptions(
            gyro_random_walk=told.gyro,
            accel_random_walk=told.accel,
            turn_noise=0.0,
            gyro_bias_walk=told.gyro_walk,
            accel_bias_walk=told.accel_walk,
            position_floor=0.0,
            height_floor=0.0,
            position_inflation=1.0,
            velocity_floor=0.0,
        ),
        initial=InsInitialOptions(
            position=told.position,
            height=told.position,
            velocity=told.velocity,
            tilt=told.tilt,
            azimuth=told.azimuth,
            gyro_bias=told.gyro_bias,
            accel_bias=told.accel_bias,
        ),
        gate=GateOptions(probability=1.0),
    )


def run_navlearn(work, method):
    """Return what the filter of this package found, by one of its forms."""
    chosen = options(work.told)
    ekf = InsEkf(chosen)
    index = work.index.expand(work.start.lat.shape[0], -1)
    timing = FixTiming(index, torch.zeros(index.shape, dtype=torch.float64))
    begin = time.process_time()
    with torch.no_grad():
        belief = initial_ins_belief(chosen, work.start)
        history = ekf(belief, work.samples, work.fixes, timing, method=method)
    spent = time.process_time() - begin
    # pyins tells nothing of the last second
    state, *others = history.belief[:3]
    kept = InsState(*(x[:, :-1] for x in state)), *(x[:, :-1] for x in others)
    return Found(history.end[0, :-1], *kept, history.trajectory, spent)


def run_pyins(work):
    """Return what pyins found about every drive of the work."""
    found = [_run_one(work, row) for row in range(work.start.lat.shape[0])]

    def stacked(states):
        return InsState(*map(torch.stack, zip(*states, strict=True)))

    return Found(
        found[0].index,
        stacked([f.state for f in found]),
        torch.stack([f.bias for f in found]),
        torch.stack([f.covariance for f in found]),
        stacked([f.inside for f in found]),
        sum(f.spent for f in found),
    )


def _run_one(work, row):
    from pyins import filters
    from pyins.inertial_sensor import EstimationModel

    told = work.told
    t = work.samples.dt[row].cumsum(0).numpy().round(6)
    read = torch.cat((work.samples.omega_ib_b[row], work.samples.f_b[row]), -1).numpy()
    imu = pd.DataFrame(read, columns=frames.GYROS + frames.ACCELS).assign(t=t)
    start = frames.solution_of(InsState(*(x[row : row + 1] for x in work.start)))
    covariances, deviations = [], filters._compute_sd

    def keep(covariance, *others):
        # what it returns holds deviations only
        covariances.append(torch.tensor(covariance))
        return deviations(covariance, *others)

    filters._compute_sd = keep
    begin = time.process_time()
    try:
        result = filters.run_feedback_filter(
            frames.pyins_pva(start, 0.0),
            told.position,
            told.velocity,
            math.degrees(told.tilt),
            math.degrees(told.azimuth),
            frames.pyins_increments(imu),
            EstimationModel(told.gyro_bias, told.gyro, told.gyro_walk),
            EstimationModel(told.accel_bias, told.accel, told.accel_walk),
            _measurements(work, row, t),
            time_step=1.0,
        )
    finally:
        filters._compute_sd = deviations
    spent = time.process_time() - begin
    later = np.flatnonzero(result.gyro.index.to_numpy() > 0.5)
    index = np.searchsorted(t, result.gyro.index.to_numpy()[later] - 1e-6)
    inside = _states(frames.of_pyins(result.trajectory.iloc[1:]))
    at = InsState(*(x[index] for x in inside))
    bias = [part.to_numpy()[later] @ frames.TURN for part in (result.gyro, result.accel)]
    matrix = torch.stack([_errors_of_pyins(v) for v in at.v_l.numpy()])
    covariance = matrix @ covariances[0][later] @ matrix.mT
    found = torch.tensor(index), at, torch.tensor(np.hstack(bias)), covariance, inside, spent
    return Found(*found)


def _measurements(work, row, t):
    from pyins.measurements import NedVelocity, Position

    fixes = GnssFix(*(x[row] for x in work.fixes))
    place = torch.stack((fixes.lat.rad2deg(), fixes.lon.rad2deg(), fixes.height), -1).numpy()
    v_n = torch.stack((fixes.v_e, fixes.v_n, fixes.v_u), -1).numpy() @ frames.TURN
    table = pd.DataFrame(
        np.hstack([place, v_n]), index=t[work.index.numpy()], columns=frames.PVA[:6]
    )
    arm = frames.TURN @ np.array(LEVER_ARM)
    position = Position(table, float(fixes.std_e[0]), arm)
    position.R = np.diag([float(s[0]) ** 2 for s in (fixes.std_n, fixes.std_e, fixes.std_u)])
    return [position, NedVelocity(table, float(fixes.std_v[0]), arm)]


def _states(solution):
    q_lb = Rotation.from_matrix(solution.C_lb).as_quat(scalar_first=True)
    v_l = torch.tensor(solution.v_l)
    return InsState(*torch.tensor(solution.position.T.copy()), v_l, torch.tensor(q_lb))


def _errors_of_pyins(v_l):
    """Return the matrix from error states of pyins to those of this package.

    There C_est = (I − [φ×]) C_true, v_est − v_true = δv + v × φ, and biases are truth minus
    estimate.
    """
    x, y, z = frames.TURN @ v_l
    matrix = np.zeros((15, 15))
    matrix[0:3, 0:3] = matrix[3:6, 3:6] = frames.TURN
    matrix[3:6, 6:9] = frames.TURN @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix[6:9, 6:9] = matrix[9:12, 9:12] = matrix[12:15, 12:15] = -frames.TURN
    return torch.tensor(matrix)


def errors_of(work, found):
    """Return estimate minus truth, shape (B, S, 15); zero for biases that are not known."""
    shapes = zip(work.truth, found.state, strict=True)
    truth = InsState(*(x[found.index].expand_as(y) for x, y in shapes))
    bias = torch.zeros_like(found.bias)
    if work.bias is not None:
        bias = found.bias - work.bias[:, found.index]
    return torch.cat((state_difference(found.state, truth), bias), -1)


def normalised_squares(work, found):
    """Return NEES over degrees of freedom per block of errors, shape (B, S) each."""
    error = errors_of(work, found)
    return {
        name: nees(error[..., part], found.covariance[..., part, part]) / (part.stop - part.start)
        for name, part in BLOCKS.items()
    }
