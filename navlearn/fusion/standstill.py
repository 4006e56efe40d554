"""What the gyro says while the car stands still at the end of a block."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.sensor_errors import SensorErrors, gyro_regressor
from navlearn.states import RissSample


class Rest(NamedTuple):
    """Standstill at the end of blocks, shape (...) each.

    Attributes:
        duration: How long the car has stood still at the block's end, within the block, s.
        yaw_rate: Mean measured yaw rate meanwhile, rad/s.
        regressors: Mean of each gyro term's regressor, shape (..., number of gyro terms).
    """

    duration: Tensor
    yaw_rate: Tensor
    regressors: Tensor


def rest_at_end(errors: SensorErrors, samples: RissSample) -> Rest:
    """Return what the gyro measured over the stationary tail of blocks.

    Args:
        errors: Sensor parameters of the filter.
        samples: Samples, shape (..., n) each; dt = 0 pads.

    Returns:
        Mean rate and regressors; zero where the car moves at the block's end.
    """
    step = torch.arange(samples.dt.shape[-1], device=samples.dt.device)
    moves = (samples.stationary <= 0.5) & (samples.dt > 0.0)
    last_move = torch.where(moves, step, -1).amax(-1, keepdim=True)
    weight = samples.dt * (step > last_move)
    duration = weight.sum(-1)
    per_second = 1.0 / duration.clamp(min=1e-9)
    means = [(weight * gyro_regressor(t, samples)).sum(-1) for t in errors.gyro_terms]
    regressors = torch.stack(means, -1) if means else duration.new_zeros((*duration.shape, 0))
    yaw_rate = (weight * samples.yaw_rate).sum(-1)
    return Rest(duration, per_second * yaw_rate, per_second.unsqueeze(-1) * regressors)
