"""Cutting a drive's timeline into blocks that end where something is measured.

A block ends at a fix or, where none comes, ``max_block`` seconds after the last one ended; a
remainder of less than a quarter joins its neighbour. Cuts depend on when fixes come, never on
what they say. Blocks of a batch are padded to common number and length with intervals of zero
length, which move nothing.
"""

from typing import NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from navlearn.states import ImuSample, RissSample

Sample = TypeVar("Sample", RissSample, ImuSample)


class Blocks(NamedTuple):
    """Blocks of a batch of drives; K counts blocks, n samples of the longest.

    Attributes:
        gather: Sample that stands at each place of each block, int64, shape (B, K, n).
        used: 1.0 where that place holds a sample, 0.0 where it pads, shape (B, K, n).
        end: Last sample of each block, int64, shape (B, K); that of the block before where a
            block is empty.
        closes: 1.0 where no later block ends at the same sample, shape (B, K).
        fix: Fix at the end of each block, int64, −1 for none, shape (B, K).
        place: Where each sample stands in the flattened (K, n), int64, shape (B, T).
        even: Whether all blocks are full, so that laying out is only a change of shape.
    """

    gather: Tensor
    used: Tensor
    end: Tensor
    closes: Tensor
    fix: Tensor
    place: Tensor
    even: bool


def cut_row(
    dt: np.ndarray, index: np.ndarray, max_block: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the blocks of one drive.

    Args:
        dt: Lengths of the intervals, s, shape (T,).
        index: Sample at whose end each fix is used, −1 for none, not decreasing, shape (M,).
        max_block: Longest block, s.

    Returns:
        First sample, sample after the last, and fix (−1 for none) of each block.
    """
    time = np.concatenate(([0.0], np.cumsum(dt)))
    fixes = np.flatnonzero(index >= 0)
    stops = index[fixes] + 1
    numbers = fixes
    if len(stops) == 0 or stops[-1] < len(dt):
        stops, numbers = np.append(stops, len(dt)), np.append(numbers, -1)
    starts = np.concatenate(([0], stops[:-1]))
    gap = time[stops] - time[starts]
    inner = np.maximum(np.ceil(gap / max_block - 0.25), 1).astype(np.int64) - 1
    owner = np.repeat(np.arange(len(stops)), inner)
    order = np.arange(len(owner)) - np.repeat(np.cumsum(inner) - inner, inner) + 1
    cuts = np.searchsorted(time, time[starts[owner]] + order * max_block - 1e-9)
    all_stops = np.concatenate((cuts, stops))
    all_fixes = np.concatenate((np.full(len(cuts), -1), numbers))
    within = np.concatenate((order, inner + 1))
    rank = np.lexsort((within, np.concatenate((owner, np.arange(len(stops))))))
    all_stops, all_fixes = all_stops[rank], all_fixes[rank]
    all_starts = np.concatenate(([0], all_stops[:-1]))
    keep = (all_stops > all_starts) | (all_fixes >= 0)
    return all_starts[keep], all_stops[keep], all_fixes[keep]


def cut(dt: Tensor, index: Tensor, max_block: float) -> Blocks:
    """Return the blocks of a batch of drives.

    Args:
        dt: Lengths of the intervals, s, shape (B, T).
        index: Sample at whose end each fix is used, −1 for none, shape (B, M).
        max_block: Longest block, s.

    Returns:
        Blocks.
    """
    rows = [
        cut_row(d, i, max_block)
        for d, i in zip(dt.detach().cpu().numpy(), index.cpu().numpy(), strict=True)
    ]
    length = dt.shape[-1]
    count = max(len(starts) for starts, _, _ in rows)
    longest = max(int((stops - starts).max()) for starts, stops, _ in rows)
    shape = (len(rows), count)
    first, size = np.full(shape, length), np.zeros(shape, dtype=np.int64)
    end, fix = np.full(shape, length - 1), np.full(shape, -1)
    for b, (starts, stops, fixes) in enumerate(rows):
        k = len(starts)
        first[b, :k], size[b, :k] = starts, stops - starts
        end[b, :k], fix[b, :k] = np.maximum(stops - 1, 0), fixes
    step = np.arange(longest)
    used = step < size[..., None]
    gather = np.where(used, first[..., None] + step, np.maximum(end, 0)[..., None])
    flat = np.arange(count * longest).reshape(count, longest)
    place = np.zeros((len(rows), length), dtype=np.int64)
    for b in range(len(rows)):
        place[b, gather[b][used[b]]] = flat[used[b]]
    closes = np.concatenate((end[:, 1:] != end[:, :-1], np.ones((len(rows), 1), bool)), 1)
    device = dt.device
    return Blocks(
        torch.from_numpy(gather).to(device),
        torch.from_numpy(used).to(dt),
        torch.from_numpy(end).to(device),
        torch.from_numpy(closes).to(dt),
        torch.from_numpy(fix).to(device),
        torch.from_numpy(place).to(device),
        bool(used.all()),
    )


def gathered(channel: Tensor, index: Tensor) -> Tensor:
    """Return a channel at given samples.

    Args:
        channel: Shape (B, T), or (B, T, 3) for a vector.
        index: Samples, int64, shape (B, ...).

    Returns:
        Shape (B, ...), or (B, ..., 3).
    """
    flat = index.flatten(1)
    if channel.dim() == 2:
        return torch.gather(channel, 1, flat).view(index.shape)
    axes = channel.shape[2:]
    wide = flat.unsqueeze(-1).expand(*flat.shape, *axes)
    return torch.gather(channel, 1, wide).view(*index.shape, *axes)


def samples_in_blocks(samples: Sample, blocks: Blocks) -> Sample:
    """Return samples laid out in blocks; padding has zero length and its neighbour's values.

    Args:
        samples: Shape (B, T) each, vectors (B, T, 3).
        blocks: Blocks of them.

    Returns:
        Shape (B, K, n) each, vectors (B, K, n, 3).
    """
    shape = blocks.gather.shape

    def laid(channel: Tensor) -> Tensor:
        if blocks.even:
            return channel.reshape(*shape, *channel.shape[2:])
        return gathered(channel, blocks.gather)

    found = type(samples)(*map(laid, samples))
    return found if blocks.even else found._replace(dt=found.dt * blocks.used)
