"""Points carried over all blocks at once: plainly, or for RISS by sums over the samples."""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.tight_belief import map_tree
from navlearn.fusion.filter_model import carried_blocks
from navlearn.fusion.tight.riss_vehicle import RissBlock, RissVehicle
from navlearn.fusion.tight.vehicle import Vehicle, VehicleAhead
from navlearn.fusion.transition import bias_scale_transition
from navlearn.fusion.unscented.fast_pass import Carry
from navlearn.fusion.unscented.stretches import in_stretches
from navlearn.fusion.unscented.sums_of_blocks import apart_at_ends, block_sums, has_sums

AT_ONCE = 200_000
"""Samples times points that are carried at once where no gradient is asked for: what a processor
keeps near at hand."""

AT_ONCE_IN_SUMS = 100_000
"""Samples that are summed up at once."""

LEFT = 1e-5
"""What sums may leave of a point's place, m; points of blocks that leave more are carried."""


def plain_carry(vehicle: Vehicle[Any]) -> Carry:
    """Return what carries every point over every sample.

    Args:
        vehicle: The vehicle.
    """

    def carry(begin: Any, deviation: Tensor, blocks: Any) -> tuple[VehicleAhead, Tensor]:
        return vehicle.predicted(begin, blocks), carried_in_parts(vehicle, begin, deviation, blocks)

    return carry


def carried_in_parts(vehicle: Vehicle[Any], begin: Any, deviation: Tensor, blocks: Any) -> Tensor:
    """Return points at the ends of blocks, some blocks at a time where no gradient is asked for.

    Args:
        vehicle: The vehicle.
        begin: Beliefs at the starts of blocks, batch shape (B, K).
        deviation: Points about them, shape (B, K, P, n).
        blocks: The blocks, batch shape (B, K).

    Returns:
        Shape (B, K, P, n).
    """
    carry = in_stretches(vehicle.carried_apart, AT_ONCE // deviation.shape[-2])
    images: Tensor = carry(begin, deviation, blocks)
    return images


def riss_carry(vehicle: RissVehicle) -> Carry:
    """Return what carries points by sums over the samples along the way of the centre.

    Args:
        vehicle: The vehicle.
    """
    model = vehicle.model
    if not has_sums(model):
        return plain_carry(vehicle)

    def carry(begin: Belief, deviation: Tensor, blocks: RissBlock) -> tuple[VehicleAhead, Tensor]:
        samples, push = blocks.samples, blocks.acceleration
        ahead = carried_blocks(model, begin, samples, push)
        linear = bias_scale_transition(
            model.errors, ahead.motion, samples, push, begin.sensor, vehicle.noise
        )
        end = begin._replace(state=ahead.state, sensor=ahead.sensor)
        sums = block_sums(model, begin, ahead.motion, samples, push)
        there = apart_at_ends(model, begin, sums, samples.dt.sum(-1), deviation)
        images, wide = there.deviation, there.left.detach() > LEFT
        if bool(wide.any()):
            images = carried_where(vehicle, wide, begin, deviation, blocks, images)
        return VehicleAhead(end, *linear), images

    return in_stretches(carry, AT_ONCE_IN_SUMS)


def carried_where(
    vehicle: Vehicle[Any],
    wide: Tensor,
    begin: Any,
    deviation: Tensor,
    blocks: Any,
    short: Tensor,
) -> Tensor:
    """Return points at the ends of blocks, carried over the samples where they stand wide apart.

    Args:
        vehicle: The vehicle.
        wide: Where they do, bool, shape (B, K).
        begin: Beliefs at the starts of blocks, batch shape (B, K).
        deviation: Points about them, shape (B, K, P, n).
        blocks: The blocks, batch shape (B, K).
        short: Points at the ends as sums tell them, shape (B, K, P, n).

    Returns:
        Shape (B, K, P, n).
    """
    some = map_tree((begin, deviation, blocks), lambda x: x[wide].unsqueeze(0))
    carried = carried_in_parts(vehicle, *some)[0]
    return short.index_put(torch.nonzero(wide, as_tuple=True), carried)
