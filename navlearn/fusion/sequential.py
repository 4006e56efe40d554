"""The filter sample by sample, as the textbook has it: the oracle of the block forms.

Each sample: mechanize, dynamics F at the middle of the interval, Van Loan discretisation,
Φ P Φᵀ + Q. Updates happen where the block forms have them.
"""

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.discretize import van_loan
from navlearn.filters.ekf import propagated
from navlearn.frames import shift_geodetic
from navlearn.fusion.error_dynamics import (
    bias_scale_dynamics,
    diffusion,
    returning,
    shen_dynamics,
    shen_terms,
)
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.recursion import Carried
from navlearn.fusion.sensor_errors import advanced, corrected_motion
from navlearn.mechanization.motion import RissMotion
from navlearn.mechanization.riss import MovedState, move
from navlearn.states import NavState, RissSample, Trajectory


def predict_sample(
    model: FilterModel, belief: Belief, sample: RissSample, acceleration: Tensor, noise: EkfNoise
) -> tuple[Belief, Tensor, MovedState]:
    """Predict one sample.

    Args:
        model: The filter.
        belief: Belief before the interval, batch shape (...).
        sample: The sample, shape (...) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (...).
        noise: Noise densities.

    Returns:
        Belief after the interval, its transition Φ, and the mechanized move.
    """
    errors = model.errors
    after, motion, moved = carried_sample(model, belief, sample, acceleration)
    azimuth = 0.5 * (belief.state.azimuth + after.state.azimuth)
    if model.layout.has_velocity:
        sine, cosine = torch.sin(azimuth), torch.cos(azimuth)
        terms = shen_terms(errors, sample, acceleration, motion, sine, cosine, model.full)
        F = shen_dynamics(terms) + returning(errors, torch.zeros_like(azimuth), 7)
    else:
        F = bias_scale_dynamics(errors, sample, acceleration, motion, azimuth, belief.sensor)
    transition, q = van_loan(F, diffusion(errors, sample, motion, noise), sample.dt)
    covariance = propagated(belief.covariance, transition, q)
    return after._replace(covariance=covariance), transition, moved


def carried_sample(
    model: FilterModel, belief: Belief, sample: RissSample, acceleration: Tensor
) -> tuple[Belief, RissMotion, MovedState]:
    """Move a belief through one sample.

    Args:
        model: The filter.
        belief: Belief before the interval, batch shape (...).
        sample: The sample, shape (...) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (...).

    Returns:
        Belief after the interval, its covariance as it was, the motion that moved it, and the
        mechanized move.
    """
    errors = model.errors
    undecayed = torch.ones_like(sample.dt)
    motion = corrected_motion(errors, sample, acceleration, belief.sensor, belief.anchor, undecayed)
    moved = move(belief.state, motion, model.earth_rate)
    state, offset = moved.state, belief.velocity_offset
    if model.layout.has_velocity:
        azimuth = 0.5 * (belief.state.azimuth + moved.state.azimuth)
        sine, cosine = torch.sin(azimuth), torch.cos(azimuth)
        terms = shen_terms(errors, sample, acceleration, motion, sine, cosine, model.full)
        state, offset = _with_offset(moved, motion, belief, (terms.east, terms.north, terms.up))
    after = belief._replace(
        state=state,
        sensor=advanced(errors, belief.sensor, belief.anchor, sample.dt),
        velocity_offset=offset,
    )
    return after, motion, moved


def _with_offset(
    moved: MovedState, motion: RissMotion, belief: Belief, direction: tuple[Tensor, ...]
) -> tuple[NavState, Tensor]:
    gain = (-belief.sensor[..., 0] * motion.dt).unsqueeze(-1)
    change = gain * torch.stack(direction, -1)
    way = (belief.velocity_offset + 0.5 * change) * motion.dt.unsqueeze(-1)
    state = moved.state
    lat, lon, height = shift_geodetic(state.lat, state.lon, state.height, *way.unbind(-1))
    return state._replace(lat=lat, lon=lon, height=height), belief.velocity_offset + change


def predict_in_turn(
    model: FilterModel,
    carried: Carried,
    samples: RissSample,
    acceleration: Tensor,
    noise: EkfNoise,
) -> tuple[Carried, Trajectory | None]:
    """Predict one block, sample after sample.

    Args:
        model: The filter.
        carried: At the start of the block.
        samples: Samples of the block, shape (B, n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (B, n).
        noise: Noise densities.

    Returns:
        What is carried to the block's end, and the trajectory inside.
    """
    point, deviation = carried
    path: list[tuple[Tensor, ...]] = []
    channels = zip(*(channel.unbind(-1) for channel in samples), strict=True)
    for k, channel in enumerate(channels):
        sample = RissSample(*channel)
        push = acceleration[..., k]
        point, transition, moved = predict_sample(model, point, sample, push, noise)
        if not model.closed:
            deviation = (transition @ deviation.unsqueeze(-1)).squeeze(-1)
        v = torch.stack((moved.v_e, moved.v_n, moved.v_u), -1) + point.velocity_offset
        path.append((*point.state, *v.unbind(-1)))
    if not model.closed:
        # beside a free mechanization the path is that from the estimates at block starts
        return Carried(point, deviation), None
    inside = Trajectory(*(torch.stack(column, -1) for column in zip(*path, strict=True)))
    return Carried(point, deviation), inside
