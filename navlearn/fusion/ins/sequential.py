"""The full-IMU filter sample by sample, as the textbook has it: the oracle of the block forms.

Each sample: strapdown, dynamics F in the middle of the interval, discretisation, Φ P Φᵀ + Q.
Updates happen where the block forms have them.
"""

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.layout import imu_corrected, imu_errors, moved_state
from navlearn.fusion.ins.model import InsFilterModel, advanced_sensor
from navlearn.fusion.ins.noise import InsNoise, walks, white_noise
from navlearn.fusion.ins.recursion import InsCarried
from navlearn.fusion.ins.sample_step import sample_step
from navlearn.mechanization.coning import coning_sculling_step
from navlearn.mechanization.strapdown import local_level_step
from navlearn.states import ImuSample, InsState


def predict_ins_sample(
    model: InsFilterModel, belief: InsBelief, sample: ImuSample, noise: InsNoise
) -> tuple[InsBelief, Tensor]:
    """Predict one sample.

    Args:
        model: The filter.
        belief: Belief before the interval, batch shape (...).
        sample: The sample, shape (...) each.
        noise: Noise densities.

    Returns:
        Belief after the interval, and its transition Φ.
    """
    return sample_step(
        belief,
        sample,
        model.layout.sensor_states,
        model.options.model == "dahmane2022",
        model.options.correlation_time,
        white_noise(noise),
        walks(model.layout, noise),
    )


def carried_ins_sample(model: InsFilterModel, belief: InsBelief, sample: ImuSample) -> InsBelief:
    """Return a belief moved over one sample, its covariance as it was.

    Args:
        model: The filter.
        belief: Belief before the interval, batch shape (...).
        sample: The sample, shape (...) each.

    Returns:
        Belief after the interval.
    """
    errors = imu_errors(model.layout, belief.sensor)
    omega, force = imu_corrected(errors, sample.omega_ib_b, sample.f_b)
    rotation, velocity = coning_sculling_step(omega, force, sample.dt)
    state = local_level_step(belief.state, rotation, velocity, sample.dt)
    return belief._replace(state=state, sensor=advanced_sensor(model, belief.sensor, sample.dt))


def predict_ins_in_turn(
    model: InsFilterModel, carried: InsCarried, samples: ImuSample, noise: InsNoise
) -> tuple[InsCarried, InsState]:
    """Predict one block, sample after sample.

    Args:
        model: The filter.
        carried: At the start of the block.
        samples: Samples of the block, shape (B, n) each.
        noise: Noise densities.

    Returns:
        What is carried to the block's end, and the trajectory inside, shape (B, n).
    """
    point, deviation = carried
    path: list[InsState] = []
    channels = zip(*(channel.unbind(1) for channel in samples), strict=True)
    for channel in channels:
        point, transition = predict_ins_sample(model, point, ImuSample(*channel), noise)
        if model.closed:
            path.append(point.state)
        else:
            deviation = (transition @ deviation.unsqueeze(-1)).squeeze(-1)
            path.append(moved_state(point.state, deviation))
    inside = InsState(*(torch.stack(column, 1) for column in zip(*path, strict=True)))
    return InsCarried(point, deviation), inside
