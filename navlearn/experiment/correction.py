"""What a fitted error model says of an outage, and solutions with it taken off."""

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel
from navlearn.learning.pseudo_outages import PseudoOutages, step_regressors
from navlearn.navigator import Navigator, without_position_error
from navlearn.recipe.anarx_spec import AnarxSpec
from navlearn.states import RissSample, Trajectory


def regressors_through(samples: RissSample, inputs: tuple[str, ...], block: int) -> Tensor:
    """Return regressors per step through an outage, of its last, unfinished step too.

    Args:
        samples: Intervals from the outage's start, shape (..., L) each.
        inputs: Names of the regressors.
        block: Samples per step.

    Returns:
        Regressors, shape (..., ⌈L / block⌉, m).
    """
    return step_regressors(_whole_steps(samples, block), inputs, block)


def predict(fitted: FittedErrorModel, spec: AnarxSpec, samples: RissSample, block: int) -> Tensor:
    """Return what a model says of every sample through an outage that starts with them.

    Args:
        fitted: The model.
        spec: What it acts on, and its inputs.
        samples: Intervals, shape (..., L) each.
        block: Samples per step of the model.

    Returns:
        For ``azimuth_rate`` the error of the yaw rate, rad/s, shape (..., L, 1); for
        ``position`` increments of its error along and across, m, shape (..., L, 2).
    """
    length = samples.dt.shape[-1]
    with torch.no_grad():
        increments: Tensor = fitted.model(regressors_through(samples, spec.inputs, block))
    each = (increments / block).repeat_interleave(block, dim=-2)[..., :length, :]
    if spec.acts_on == "azimuth_rate":
        # Azimuth turns against the yaw rate: too much azimuth is too little yaw rate.
        return -each / samples.dt.clamp(min=1e-9).unsqueeze(-1)
    return each


def without_predicted_position_error(
    predicted: Trajectory, increments: Tensor, block: int
) -> Trajectory:
    """Return a trajectory less what a model says of its position error.

    The increments of a step are in the frame of the azimuth at its end, as they were learned.

    Args:
        predicted: Trajectory through an outage, shape (..., L) each.
        increments: Increments of its error along and across, m, shape (..., L, 2).
        block: Samples per step of the model.
    """
    length = predicted.azimuth.shape[-1]
    ends = torch.arange(length) // block * block + block - 1
    azimuth = predicted.azimuth[..., ends.clamp(max=length - 1)]
    return without_position_error(predicted, increments[..., 0], increments[..., 1], azimuth)


def correct(
    fitted: FittedErrorModel, spec: AnarxSpec, navigator: Navigator, outages: PseudoOutages
) -> Trajectory:
    """Return emulated outages with the model's prediction taken off.

    Args:
        fitted: The model.
        spec: What it acts on, and its inputs.
        navigator: What emulated the outages.
        outages: Emulated outages.

    Returns:
        Trajectory, shape (N, L) each.
    """
    prediction = predict(fitted, spec, outages.samples, outages.block)
    if spec.acts_on == "azimuth_rate":
        return navigator.coast(outages.belief, outages.samples, prediction[..., 0])
    return without_predicted_position_error(outages.predicted, prediction, outages.block)


def _whole_steps(samples: RissSample, block: int) -> RissSample:
    """Return the samples of whole steps; the last step is filled up by repeating its end."""
    missing = -samples.dt.shape[-1] % block
    if missing == 0:
        return samples
    return RissSample(
        *(
            torch.cat((channel, channel[..., -1:].expand(*channel.shape[:-1], missing)), -1)
            for channel in samples
        )
    )
