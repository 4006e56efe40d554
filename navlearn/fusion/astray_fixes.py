"""Which fixes of RISS drives are astray, and at the end of which blocks they stand."""

import torch
from torch import Tensor

from navlearn.fusion.blocks import Blocks, gathered
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.motion_check import astray
from navlearn.fusion.seen_fixes import Carriage
from navlearn.states import FixTiming, GnssFix, RissSample


def astray_fixes(
    model: FilterModel, samples: RissSample, fixes: GnssFix, timing: FixTiming
) -> Tensor:
    """Return which fixes have moved otherwise than the car.

    Args:
        model: The filter.
        samples: Samples, shape (B, T) each.
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.

    Returns:
        1.0 where one has, shape (B, M).
    """
    right, forward, _ = model.options.lever_arm
    return astray(model.gate, (right, forward), carriage(model, samples), fixes, timing)


def carriage(model: FilterModel, samples: RissSample) -> Carriage:
    """Return how samples carry a car, as a filter's mechanization has it.

    Args:
        model: The filter.
        samples: Samples, shape (...) each.
    """
    speed = samples.speed
    if model.errors.three_d:
        speed = speed * torch.cos(samples.pitch)
    return Carriage(samples.dt, -samples.yaw_rate, speed, torch.ones_like(speed))


def astray_at_ends(blocks: Blocks, found: Tensor) -> Tensor:
    """Return whether the fix at the end of each block is astray.

    Args:
        blocks: Blocks.
        found: Whether each fix is, shape (B, M); M at least 1.

    Returns:
        1.0 where it is, shape (B, K).
    """
    return gathered(found, blocks.fix.clamp(min=0)) * (blocks.fix >= 0)
