"""Prediction over a block of samples at once: the exact form's step.

The complete model composes by preintegration, whose transition is in closed form
(:mod:`navlearn.mechanization.preintegration`). Simplified dynamics and decaying biases have no
closed form: there the transitions of all samples are found together and multiplied pairwise.
"""

import torch
from torch import Tensor

from navlearn.filters.ekf import propagated
from navlearn.filters.ins_belief import InsBelief
from navlearn.frames import enu_between
from navlearn.fusion.ins.error_dynamics import motion_between
from navlearn.fusion.ins.layout import imu_corrected, imu_errors
from navlearn.fusion.ins.linear_steps import composed, discretized
from navlearn.fusion.ins.model import InsFilterModel, advanced_sensor, diffusion, dynamics
from navlearn.fusion.ins.noise import InsNoise, walks
from navlearn.fusion.ins.path import path_over_samples, states_before
from navlearn.fusion.ins.recursion import InsCarried
from navlearn.mechanization.preintegration import Preintegrated, preintegrate
from navlearn.mechanization.preintegration_predict import predict, predict_with_way
from navlearn.mechanization.preintegration_transition import block_transition
from navlearn.states import ImuSample, InsState


def predict_ins_composed(
    model: InsFilterModel, carried: InsCarried, samples: ImuSample, noise: InsNoise
) -> tuple[InsCarried, None]:
    """Predict one block, all its samples at once.

    Args:
        model: The filter.
        carried: At the start of the block.
        samples: Samples of the block, coning compensated, shape (B, n) each.
        noise: Noise densities.

    Returns:
        What is carried to the block's end; the trajectory inside is left to a later pass.
    """
    point, deviation = carried
    moved, transition, q = ahead_of(model, point, samples, noise)
    moved = moved._replace(covariance=propagated(point.covariance, transition, q))
    if not model.closed:
        deviation = (transition @ deviation.unsqueeze(-1)).squeeze(-1)
    return InsCarried(moved, deviation), None


def ahead_of(
    model: InsFilterModel, point: InsBelief, samples: ImuSample, noise: InsNoise
) -> tuple[InsBelief, Tensor, Tensor]:
    """Return the ends of blocks and their linearisation.

    Args:
        model: The filter.
        point: Belief at the start of each block, batch shape (...).
        samples: Samples of the blocks, coning compensated, shape (..., n) each.
        noise: Noise densities.

    Returns:
        Belief at the end, covariance as at the start; Φ and Q.
    """
    compose = by_preintegration if has_closed_form(model) else by_product
    held, sensor = _sensor_over(model, point, samples)
    state, transition, q = compose(model, held, samples, noise)
    return point._replace(state=state, sensor=sensor), transition, q


def end_of(
    model: InsFilterModel, point: InsBelief, samples: ImuSample, noise: InsNoise
) -> tuple[InsBelief, Tensor]:
    """Return the ends of blocks alone, as :func:`ahead_of` has them, and the ways there.

    Args:
        model: The filter.
        point: Belief at the start of each block, batch shape (...).
        samples: Samples of the blocks, coning compensated, shape (..., n) each.
        noise: Noise densities.

    Returns:
        Belief at the end, covariance as at the start; and how far that is from the start, east,
        north, up, m, shape (..., 3).
    """
    held, sensor = _sensor_over(model, point, samples)
    if has_closed_form(model):
        pre = preintegrated(model, held.sensor, samples, noise)
        state, way = predict_with_way(point.state, pre)
    else:
        state = _last(path_over_samples(model, held, samples), point)
        way = torch.stack(enu_between(*state[:3], *point.state[:3]), -1)
    return point._replace(state=state, sensor=sensor), way


def _sensor_over(
    model: InsFilterModel, point: InsBelief, samples: ImuSample
) -> tuple[InsBelief, Tensor]:
    """Return beliefs whose sensor parameters hold over blocks, and the parameters afterwards."""
    duration = samples.dt.sum(-1)
    # a bias that decays is held at its value in the middle of the block
    held = point._replace(sensor=advanced_sensor(model, point.sensor, 0.5 * duration))
    return held, advanced_sensor(model, point.sensor, duration)


def _last(path: InsState, point: InsBelief) -> InsState:
    along = point.state.lat.dim()
    return InsState(*(channel.select(along, -1) for channel in path))


def by_preintegration(
    model: InsFilterModel, point: InsBelief, samples: ImuSample, noise: InsNoise
) -> tuple[InsState, Tensor, Tensor]:
    """Return the end of a block and its linearisation, by preintegration.

    Args:
        model: The filter.
        point: Belief at the start of the block, batch shape (...).
        samples: Samples of the block, shape (..., n) each.
        noise: Noise densities.

    Returns:
        State at the end, Φ and Q.
    """
    pre = preintegrated(model, point.sensor, samples, noise)
    transition, q = block_transition(point.state, pre, walks(model.layout, noise))
    return predict(point.state, pre), transition, q


def has_closed_form(model: InsFilterModel) -> bool:
    """Return whether preintegration tells a block's transition: biases stay, nothing simplified.

    Args:
        model: The filter.
    """
    steady = model.options.correlation_time == float("inf") or not model.layout.has_bias
    return model.options.model == "phi_angle" and steady


def preintegrated(
    model: InsFilterModel, sensor: Tensor, samples: ImuSample, noise: InsNoise
) -> Preintegrated:
    """Return the increments of blocks, with derivatives in the filter's sensor parameters.

    Args:
        model: The filter.
        sensor: Sensor parameters to take off, shape (..., m).
        samples: Samples of the blocks, coning compensated, shape (..., n) each.
        noise: Noise densities.

    Returns:
        Increments, batch shape (...).
    """
    errors = imu_errors(model.layout, sensor)
    has_bias, has_scale = model.layout.has_bias, model.layout.has_scale
    pre = preintegrate(
        samples.omega_ib_b,
        samples.f_b,
        samples.dt,
        gyro_random_walk=noise.gyro_random_walk,
        accel_random_walk=noise.accel_random_walk,
        turn_noise=noise.turn_noise,
        gyro_bias=errors.gyro_bias if has_bias else None,
        accel_bias=errors.accel_bias if has_bias else None,
        gyro_scale=errors.gyro_gain - 1.0 if has_scale else None,
        accel_scale=errors.accel_gain - 1.0 if has_scale else None,
        scale_factors=has_scale,
    )
    # nine states without biases: what they would do is no column of Φ
    return pre if has_bias else pre._replace(by_sensor=pre.by_sensor[..., :0])


def by_product(
    model: InsFilterModel, point: InsBelief, samples: ImuSample, noise: InsNoise
) -> tuple[InsState, Tensor, Tensor]:
    """Return the end of a block and its linearisation, by multiplying those of its samples.

    Args:
        model: The filter.
        point: Belief at the start of the block, batch shape (...).
        samples: Samples of the block, shape (..., n) each.
        noise: Noise densities.

    Returns:
        State at the end, Φ and Q.
    """
    ends = path_over_samples(model, point, samples)
    errors = imu_errors(model.layout, point.sensor.unsqueeze(-2))
    omega, force = imu_corrected(errors, samples.omega_ib_b, samples.f_b)
    F = dynamics(
        model, motion_between(states_before(point.state, ends), ends, omega, force), errors
    )
    transition, q = discretized(F, diffusion(model.layout, omega, noise), samples.dt)
    return _last(ends, point), *composed(transition, q)
