"""The predicted path inside blocks, mechanized from the beliefs at their starts."""

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.layout import imu_corrected, imu_errors
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.timeline import InsTimeline
from navlearn.fusion.record import starts_of_blocks
from navlearn.mechanization.coning import coning_sculling_step
from navlearn.mechanization.strapdown_parallel import local_level_over_time
from navlearn.states import ImuSample, InsState


def increments(model: InsFilterModel, sensor: Tensor, samples: ImuSample) -> tuple[Tensor, Tensor]:
    """Return what blocks of samples turn and push the car by, sensor errors removed.

    Args:
        model: The filter.
        sensor: Sensor parameters of each block, shape (..., m).
        samples: Samples, coning compensated, shape (..., n) each, vectors (..., n, 3).

    Returns:
        Rotation vectors (rad) and velocity increments (m/s), shape (..., n, 3) each.
    """
    errors = imu_errors(model.layout, sensor.unsqueeze(-2))
    omega, force = imu_corrected(errors, samples.omega_ib_b, samples.f_b)
    return coning_sculling_step(omega, force, samples.dt)


def path_over_samples(model: InsFilterModel, begin: InsBelief, samples: ImuSample) -> InsState:
    """Return the path over blocks of samples, all blocks and samples at once.

    Args:
        model: The filter.
        begin: Beliefs at the starts of blocks, batch shape (...).
        samples: Samples, coning compensated, shape (..., n) each, vectors (..., n, 3).

    Returns:
        States at the ends of samples, batch shape (..., n).
    """
    rotation, velocity = increments(model, begin.sensor, samples)
    return local_level_over_time(begin.state, rotation, velocity, samples.dt)


def ins_path_in_blocks(
    model: InsFilterModel, start: InsBelief, after: InsBelief, line: InsTimeline
) -> InsState:
    """Return the predicted path inside all blocks.

    Args:
        model: The filter.
        start: Belief before the first block, batch shape (B,).
        after: Beliefs after each block, batch shape (B, K).
        line: The drives in blocks.

    Returns:
        Trajectory, batch shape (B, K, n).
    """
    return path_over_samples(model, starts_of_blocks(start, after), line.samples)


def states_before(start: InsState, ends: InsState) -> InsState:
    """Return the states before samples, from the start and the states after them.

    Args:
        start: Before the first sample, batch shape (...).
        ends: After each sample, batch shape (..., n).

    Returns:
        Batch shape (..., n).
    """
    along = start.lat.dim()
    return InsState(
        *(
            torch.cat((first.unsqueeze(along), rest.narrow(along, 0, rest.shape[along] - 1)), along)
            for first, rest in zip(start, ends, strict=True)
        )
    )
