"""Straight lines through what fixes say: where first guesses take positions and velocities from."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.states import GnssFix


class StraightLines(NamedTuple):
    """Values between blocks.

    Attributes:
        told: At the starts of blocks and the end of the last, held behind the last value, shape
            (B, K + 1, d).
        gap: Time between the values on both sides of a block's middle, s, infinite behind the
            last, shape (B, K).
    """

    told: Tensor
    gap: Tensor


def straight_lines(
    first: Tensor, values: Tensor, there: Tensor, delay: Tensor, duration: Tensor
) -> StraightLines:
    """Return values between blocks by straight lines.

    Args:
        first: Values before the first block, shape (B, d).
        values: Values told at the ends of blocks, shape (B, K, d).
        there: Whether there is one, bool, shape (B, K).
        delay: End of the block minus the time of the value, s, shape (B, K).
        duration: Length of the blocks, s, shape (B, K).

    Returns:
        Values and gaps, without gradients.
    """
    clock = torch.nn.functional.pad(torch.cumsum(duration, 1), (1, 0)).detach().numpy()
    count, axes = clock.shape[1], first.shape[-1]
    told, gap = np.empty((len(clock), count, axes)), np.empty((len(clock), count - 1))
    given = (x.detach().numpy() for x in (first, values, there, delay))
    for row, (begin, known, use, late) in enumerate(zip(*given, strict=True)):
        at = clock[row, 1:] - late
        # knots in order: delays may overtake each other
        chosen = np.flatnonzero(use & (at > 0.0))
        chosen = chosen[np.argsort(at[chosen], kind="stable")]
        stamps = np.concatenate(([0.0], at[chosen]))
        knots = np.concatenate((begin[None], known[chosen]))
        for axis in range(axes):
            told[row, :, axis] = np.interp(clock[row], stamps, knots[:, axis])
        after = np.searchsorted(stamps, 0.5 * (clock[row, 1:] + clock[row, :-1]))
        ends = np.append(stamps, np.inf)
        gap[row] = ends[after] - stamps[np.maximum(after - 1, 0)]
    return StraightLines(torch.from_numpy(told), torch.from_numpy(gap))


def positions_between(
    start: tuple[Tensor, Tensor, Tensor], fix: GnssFix, delay: Tensor, duration: Tensor
) -> StraightLines:
    """Return latitude, longitude (rad) and height (m) between blocks, as fixes tell them.

    Args:
        start: Latitude, longitude, height before the first block, shape (B,) each.
        fix: Fixes at the ends of blocks, shape (B, K) each.
        delay: End of the block minus the fix's time, s, shape (B, K).
        duration: Length of the blocks, s, shape (B, K).
    """
    origin = start[1].unsqueeze(1)
    # straight lines must not lead round the Earth
    lon = origin + wrap_angle(fix.lon - origin)
    values = torch.stack((fix.lat, lon, fix.height), -1)
    return straight_lines(torch.stack(start, -1), values, fix.has_position > 0.5, delay, duration)
