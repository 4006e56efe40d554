"""The smoother of an unscented filter: Rauch–Tung–Striebel with what sigma points tell of blocks.

[Sarkka2008]: points about the filter's beliefs give the covariance of a block's start with its end,
P Φᵀ with the regressed Φ, and what a line does not explain is process noise. One pass backwards;
measurements are those that the filter took.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.smoother import Forward, smooth_in_parallel
from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import SigmaWeights
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.smoothed_blocks import SmoothedPass
from navlearn.fusion.tight.vehicle import Vehicle
from navlearn.fusion.unscented.fast_pass import Carry, regressed_blocks


def smoothed_by_points(
    vehicle: Vehicle[Any],
    weights: SigmaWeights,
    carry: Carry,
    start: Any,
    blocks: Any,
    history: Any,
) -> SmoothedPass[Any]:
    """Smooth what an unscented filter made of drives.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        carry: Carries points over all blocks.
        start: Belief before the first block, batch shape (B,).
        blocks: The blocks, batch shape (B, K).
        history: What the filter made of them; ``belief``, ``innovation`` and ``verdict`` are read.

    Returns:
        Smoothed beliefs.
    """
    begin = starts_of_blocks(start, history.belief)
    linear = regressed_blocks(vehicle, weights, carry, begin, blocks)
    noise = linear.noise
    if bool((history.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
        innovation = torch.nan_to_num(history.innovation)
        opened = vehicle.opened(history.verdict, linear.found, innovation)
        noise = noise + torch.diag_embed(opened)
    # every belief relative to what was predicted for it; so nothing is predicted ahead of any
    corrected = -vehicle.difference(linear.end, history.belief, blocks)
    mean = torch.nn.functional.pad(corrected, (0, 0, 1, 0))
    covariance = torch.cat((start.covariance.unsqueeze(1), history.belief.covariance), 1)
    found = smooth_in_parallel(
        Forward(mean, covariance, torch.zeros_like(corrected), linear.transition, noise)
    )
    first = vehicle.moved_at_start(start, found.mean[:, 0], map_tree(blocks, _first))
    after = vehicle.moved(linear.end, found.mean[:, 1:], blocks)
    return SmoothedPass(
        first._replace(covariance=found.covariance[:, 0]),
        after._replace(covariance=found.covariance[:, 1:]),
        linear.transition,
        found.gain,
    )


def _first(x: Tensor) -> Tensor:
    return x[:, 0]
