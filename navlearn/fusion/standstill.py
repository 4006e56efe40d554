"""What the gyro says while the car stands still at the end of a block.

Blocks end at fixes. Where a receiver tells several a second, a standstill is longer than a block:
how long the car has stood counts across blocks, what the gyro said only within one.
"""

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
        standing: How long the car has stood still at the block's end, earlier blocks included, s.
    """

    duration: Tensor
    yaw_rate: Tensor
    regressors: Tensor
    standing: Tensor


def rest_at_end(errors: SensorErrors, samples: RissSample) -> Rest:
    """Return what the gyro measured over the stationary tail of blocks.

    Args:
        errors: Sensor parameters of the filter.
        samples: Samples of consecutive blocks, shape (..., K, n) each; dt = 0 pads.

    Returns:
        Mean rate and regressors, batch shape (..., K); zero where the car moves at the block's
        end.
    """
    weight, duration, standing = stationary_tail(samples.dt, samples.stationary)
    per_second = 1.0 / duration.clamp(min=1e-9)
    means = [(weight * gyro_regressor(t, samples)).sum(-1) for t in errors.gyro_terms]
    regressors = torch.stack(means, -1) if means else duration.new_zeros((*duration.shape, 0))
    yaw_rate = (weight * samples.yaw_rate).sum(-1)
    return Rest(
        duration,
        per_second * yaw_rate,
        per_second.unsqueeze(-1) * regressors,
        standing,
    )


def stationary_tail(dt: Tensor, stationary: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return how long the car has stood still at the end of blocks.

    Args:
        dt: Lengths of the samples of consecutive blocks, s, shape (..., K, n); 0 pads.
        stationary: 1.0 where the car stands still, shape (..., K, n).

    Returns:
        Length of each sample of a block's stationary tail, zero elsewhere (s, shape (..., K, n));
        the tail's duration; and how long the car has stood, earlier blocks included (s, shape
        (..., K) each).
    """
    step = torch.arange(dt.shape[-1], device=dt.device)
    moves = (stationary <= 0.5) & (dt > 0.0)
    last_move = torch.where(moves, step, -1).amax(-1, keepdim=True)
    weight = dt * (step > last_move)
    duration = weight.sum(-1)
    return weight, duration, _across_blocks(duration, moves.any(-1))


def _across_blocks(duration: Tensor, moved: Tensor) -> Tensor:
    """Return how long the car has stood still, counted since the last block that it moved in.

    Args:
        duration: Standstill at each block's end, s, shape (..., K).
        moved: Whether the car moved in the block.
    """
    total = torch.cumsum(duration, -1)
    before = torch.where(moved, total - duration, 0.0)
    return total - torch.cummax(before, -1).values
