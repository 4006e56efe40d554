"""Noise of ranges and of the receiver's clock as tensors, so that it can be learned."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.gnss.range_noise import RangeNoise, log_range_noise, range_noise_from_log

CLOCK_NOISE = ("frequency_noise", "frequency_walk", "offset_walk")
"""Entries of :class:`navlearn.fusion.tight.options.ClockOptions` that are noise."""


class TightNoise(NamedTuple):
    """Noise of the tightly coupled filter beside that of its vehicle; tensors of shape () each.

    Attributes:
        range: Noise of ranges and range rates.
        frequency_noise: How the clock's bias walks, m/√s.
        frequency_walk: How its drift walks, m/s/√s.
        offset_walk: How the time of a further system walks, m/√s.
    """

    range: RangeNoise
    frequency_noise: Tensor
    frequency_walk: Tensor
    offset_walk: Tensor


def log_tight_noise(options: TightEkfOptions) -> Tensor:
    """Return the logarithms of all noise entries, what an optimiser moves.

    Args:
        options: Choices of the filter.

    Returns:
        Those of :class:`navlearn.gnss.range_noise.RangeNoise`, then the clock's three, −inf for
        zero, shape (14,).
    """
    clock = [getattr(options.clock, name) for name in CLOCK_NOISE]
    log_clock = torch.log(torch.tensor(clock, dtype=torch.float64))
    return torch.cat((log_range_noise(options.range_noise), log_clock))


def tight_noise_from_log(log: Tensor) -> TightNoise:
    """Return the noise entries of their logarithms.

    Args:
        log: As :func:`log_tight_noise` returns, shape (14,).
    """
    count = len(RangeNoise._fields)
    return TightNoise(range_noise_from_log(log[:count]), *torch.exp(log[count:]).unbind(-1))
