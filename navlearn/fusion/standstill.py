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
    padding = samples.dt == 0.0
    still = (samples.stationary > 0.5) | padding
    tail = torch.flip(torch.cumprod(torch.flip(still.to(samples.dt), (-1,)), -1), (-1,))
    weight = tail * samples.dt
    duration = weight.sum(-1)
    share = weight / duration.clamp(min=1e-9).unsqueeze(-1)
    terms = errors.gyro_terms
    means = [(share * gyro_regressor(term, samples)).sum(-1) for term in terms]
    regressors = torch.stack(means, -1) if means else duration.new_zeros((*duration.shape, 0))
    return Rest(duration, (share * samples.yaw_rate).sum(-1), regressors)
