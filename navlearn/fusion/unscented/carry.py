"""Points carried over all blocks at once: plainly, or for RISS by sums over the samples."""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.tight_belief import map_tree
from navlearn.fusion.filter_model import carried_blocks
from navlearn.fusion.tight.riss_vehicle import RissBlock, RissVehicle
from navlearn.fusion.tight.vehicle import Vehicle, VehicleAhead, VehicleLine
from navlearn.fusion.transition import bias_scale_transition
from navlearn.fusion.unscented.fast_pass import Carry
from navlearn.fusion.unscented.sums_of_blocks import apart_at_ends, block_sums, has_sums

AT_ONCE = 200_000
"""Samples times points that are carried at once where no gradient is asked for: what a processor
keeps near at hand."""

LEFT = 1e-5
"""What sums may leave of a point's place, m; points of blocks that leave more are carried."""


def plain_carry(vehicle: Vehicle[Any], line: VehicleLine) -> Carry:
    """Return what carries every point over every sample.

    Args:
        vehicle: The vehicle.
        line: The drives in blocks.
    """
    blocks = vehicle.all_blocks(line)

    def carry(begin: Any, deviation: Tensor) -> tuple[VehicleAhead, Tensor]:
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
    drives, count, points = deviation.shape[:3]
    samples = blocks.samples.dt.shape[-1]
    size = max(1, AT_ONCE // (drives * points * samples))
    if torch.is_grad_enabled() or size >= count:
        return vehicle.carried_apart(begin, deviation, blocks)
    parts: list[Tensor] = []
    for k in range(0, count, size):
        some = map_tree((begin, blocks), lambda x, k=k: x[:, k : k + size])
        parts.append(vehicle.carried_apart(some[0], deviation[:, k : k + size], some[1]))
    return torch.cat(parts, 1)


def riss_carry(vehicle: RissVehicle, line: VehicleLine) -> Carry:
    """Return what carries points by sums over the samples along the way of the centre.

    Args:
        vehicle: The vehicle.
        line: The drives in blocks.
    """
    if not has_sums(vehicle.model):
        return plain_carry(vehicle, line)
    blocks = vehicle.all_blocks(line)
    elapsed = blocks.samples.dt.sum(-1)

    def carry(begin: Belief, deviation: Tensor) -> tuple[VehicleAhead, Tensor]:
        model, (samples, push) = vehicle.model, blocks[:2]
        ahead = carried_blocks(model, begin, samples, push)
        linear = bias_scale_transition(
            model.errors, ahead.motion, samples, push, begin.sensor, vehicle.noise
        )
        end = begin._replace(state=ahead.state, sensor=ahead.sensor)
        centre = VehicleAhead(end, linear.transition, linear.noise)
        sums = block_sums(model, begin, ahead.motion, samples, push)
        there = apart_at_ends(model, begin, sums, elapsed, deviation)
        wide = there.left.detach() > LEFT
        if bool(wide.any()):
            return centre, _carried_where(vehicle, wide, begin, deviation, blocks, there.deviation)
        return centre, there.deviation

    return carry


def _carried_where(
    vehicle: RissVehicle,
    wide: Tensor,
    begin: Belief,
    deviation: Tensor,
    blocks: RissBlock,
    short: Tensor,
) -> Tensor:
    """Return points at the ends of blocks, carried over the samples where they stand wide apart."""
    some = map_tree((begin, deviation, blocks), lambda x: x[wide].unsqueeze(0))
    carried = carried_in_parts(vehicle, *some)[0]
    return short.index_put(torch.nonzero(wide, as_tuple=True), carried)
