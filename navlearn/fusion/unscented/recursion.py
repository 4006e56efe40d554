"""The unscented filter as a loop over blocks: predict one, update at its end, go on."""

from typing import Any

import torch

from navlearn.filters.unscented import SigmaWeights
from navlearn.fusion.record import Ended
from navlearn.fusion.recursion import stacked
from navlearn.fusion.tight.vehicle import Vehicle, VehicleLine, blocks_in_turn
from navlearn.fusion.unscented.prediction import (
    RootedBelief,
    predicted,
    predicted_in_turn,
    rooted,
)
from navlearn.fusion.unscented.update import measured_by_points, updated


def end_block(
    vehicle: Vehicle[Any], weights: SigmaWeights, prior: RootedBelief, block: Any
) -> tuple[RootedBelief, Ended]:
    """Update at the end of a block.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        prior: Prediction at the block's end, batch shape (B,).
        block: The block, batch shape (B,).

    Returns:
        Belief after the update, and the record of this end.
    """
    found = measured_by_points(vehicle, weights, prior, block)
    after, judged = updated(vehicle, prior, found, block)
    there = vehicle.rows.spread(found.present) > 0.5
    shown = torch.where(there, found.innovation, torch.nan)
    none = torch.zeros_like(prior.root[..., 0])
    return after, Ended(prior.belief, after.belief, shown, judged, none)


def run_unscented_loop(
    vehicle: Vehicle[Any],
    weights: SigmaWeights,
    start: Any,
    line: VehicleLine,
    *,
    in_turn: bool = False,
) -> Ended:
    """Run the filter block after block.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        in_turn: Whether points are drawn anew at every sample, not only at every block's start.

    Returns:
        Every block's end, batch shape (B, K).
    """
    at, ends = rooted(start), list[Ended]()
    predict = predicted_in_turn if in_turn else predicted
    for block in blocks_in_turn(vehicle, line):
        at, ended = end_block(vehicle, weights, predict(vehicle, weights, at, block), block)
        ends.append(ended)
    record: Ended = stacked(ends)
    return record
