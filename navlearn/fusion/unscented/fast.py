"""The unscented filter with all blocks at once.

As :mod:`navlearn.fusion.fast`, but what is guessed of every block's start is mean and covariance:
sigma points are drawn from both. A pass regresses all blocks at the guess and runs one linear
filter, parallel in time, over them; where the guess is what the filter returns, that is the loop
over blocks itself. Where azimuth is hardly known points lie all round and no guess will do: such
blocks go one after another until it is known, and the passes take the others.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import SigmaWeights
from navlearn.fusion.batch_axis import wants_gradient
from navlearn.fusion.convergence import solved
from navlearn.fusion.drives import Method
from navlearn.fusion.record import Ended
from navlearn.fusion.recursion import stacked, unstacked
from navlearn.fusion.tight.vehicle import Vehicle, VehicleLine
from navlearn.fusion.unscented.fast_pass import Carry
from navlearn.fusion.unscented.passes import UnscentedPasses
from navlearn.fusion.unscented.prediction import RootedBelief, predicted, rooted
from navlearn.fusion.unscented.recursion import end_block
from navlearn.fusion.unscented.stretches import joined

WIDE = 0.5
"""Deviation of azimuth above which blocks go one after another, rad."""

AZIMUTH = ("azimuth", "phi_up")
"""Names of the azimuth's error among error states."""


class AllAtOnce(NamedTuple):
    """What came of a run.

    Attributes:
        record: Every block's end, batch shape (B, K).
        method: ``fast``, or ``exact`` where the loop over blocks had to answer.
        passes: Passes over all blocks; 1 for the loop.
    """

    record: Ended
    method: Method
    passes: int


def run_unscented_fast(
    vehicle: Vehicle[Any], weights: SigmaWeights, carry: Carry, start: Any, line: VehicleLine
) -> AllAtOnce:
    """Run the filter over all blocks at once.

    Args:
        vehicle: The vehicle.
        weights: Weights of the sigma points.
        carry: Carries points over blocks.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.

    Returns:
        Every block's end. The loop over blocks answers where the vehicle has no passes, they did
        not converge, what is believed oscillates, or azimuth is never known.
    """
    blocks, count = vehicle.all_blocks(line), line.blocks.end.shape[1]
    at, ends, turns = rooted(start), list[Ended](), list[Any]()
    if _wide(vehicle, at.belief):
        turns = unstacked(blocks)
    while len(ends) < count and _wide(vehicle, at.belief):
        at, ended = _one_block(vehicle, weights, at, turns[len(ends)])
        ends.append(ended)
    gone = len(ends)
    if gone < count:
        rest = map_tree(blocks, lambda x: x[:, gone:]) if gone > 0 else blocks
        later = _later(line, gone)
        differentiable = 3 if gone > 0 else 2
        found = _solved(vehicle, weights, carry, at.belief, later, rest, differentiable)
        if found is not None:
            record, passes = found
            return AllAtOnce(joined([stacked(ends), record]) if ends else record, "fast", passes)
        turns = turns or unstacked(blocks)
    for block in turns[gone:]:
        at, ended = _one_block(vehicle, weights, at, block)
        ends.append(ended)
    return AllAtOnce(stacked(ends), "exact", 1)


def _one_block(
    vehicle: Vehicle[Any], weights: SigmaWeights, at: RootedBelief, block: Any
) -> tuple[RootedBelief, Ended]:
    return end_block(vehicle, weights, predicted(vehicle, weights, at, block), block)


def _wide(vehicle: Vehicle[Any], belief: Any) -> bool:
    """Return whether azimuth is hardly known in any drive."""
    for name in AZIMUTH:
        if name in vehicle.names:
            k = vehicle.names.index(name)
            return bool((belief.covariance[..., k, k] > WIDE * WIDE).any())
    return False


def _solved(
    vehicle: Vehicle[Any],
    weights: SigmaWeights,
    carry: Carry,
    start: Any,
    line: VehicleLine,
    blocks: Any,
    differentiable: int,
) -> tuple[Ended, int] | None:
    of_vehicle = vehicle.passes(start, line)
    if of_vehicle is None:
        return None
    passes = UnscentedPasses(vehicle, weights, carry, start, blocks, of_vehicle)
    learning = torch.is_grad_enabled() and _wants_gradient(vehicle, start, line)
    with torch.no_grad():
        begin = passes.roughly(line.line.occasion.fix)
    found = solved(begin, passes, learning, differentiable)
    return None if found is None else (found[0], found[1] + passes.extended)


def _wants_gradient(vehicle: Vehicle[Any], start: Any, line: VehicleLine) -> bool:
    leaves: list[Tensor] = []

    def kept(leaf: Tensor) -> Tensor:
        leaves.append(leaf)
        return leaf

    map_tree((start, line.line), kept)
    if isinstance(vehicle, torch.nn.Module):
        leaves += vehicle.parameters()
    return wants_gradient(leaves)


def _later(line: VehicleLine, gone: int) -> VehicleLine:
    """Return the drives from a block on, as far as passes look at them."""
    if gone == 0:
        return line

    def cut(x: Tensor) -> Tensor:
        return x[:, gone:]

    old = line.blocks
    blocks = old._replace(
        gather=cut(old.gather),
        used=cut(old.used),
        end=cut(old.end),
        closes=cut(old.closes),
        fix=cut(old.fix),
    )
    own = line.line
    rest = {name: map_tree(getattr(own, name), cut) for name in own._fields if name != "blocks"}
    return VehicleLine(blocks, own._replace(blocks=blocks, **rest), cut(line.delay))
