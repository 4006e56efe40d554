"""One pass of the unscented filter's fast form: every block regressed, one linear filter over all.

The unscented filter is a linear Kalman filter whose Φ, H and noise are regressed on sigma points:
at a block's start on those of the belief there, at its end on those of its prediction. A pass
regresses all blocks at guesses of the beliefs with which they start.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ekf import symmetrized
from navlearn.filters.square_root import root_of
from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import SigmaWeights, image_moments, sigma_points
from navlearn.fusion.gated_pass import Behind, Linearised, filtered_behind_gate
from navlearn.fusion.gating import Judged
from navlearn.fusion.measured import Measured
from navlearn.fusion.record import Ended
from navlearn.fusion.tight.vehicle import Vehicle, VehicleAhead
from navlearn.fusion.unscented.prediction import PointsAhead, RootedBelief
from navlearn.fusion.unscented.update import measured_by_points

Carry = Callable[[Any, Tensor, Any], tuple[VehicleAhead, Tensor]]
"""Carries beliefs at the starts of blocks, batch shape (B, K), and points about them, shape (B, K,
P, n), over the blocks: gives the central point with its linear model, and the others relative to
it."""


class LinearBlocks(NamedTuple):
    """All blocks as a linear filter takes them.

    Attributes:
        begin: Beliefs at which blocks start by the guess, batch shape (B, K).
        end: What is predicted from there, batch shape (B, K).
        transition: Φ, shape (B, K, n, n).
        noise: Process noise, Ω in it, shape (B, K, n, n).
        found: What is measured at the ends.
    """

    begin: Any
    end: Any
    transition: Tensor
    noise: Tensor
    found: Measured


def regressed_blocks(
    vehicle: Vehicle[Any], weights: SigmaWeights, carry: Carry, begin: Any, blocks: Any
) -> LinearBlocks:
    """Return all blocks as sigma points see them.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        carry: Carries points over all blocks.
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).
        blocks: The blocks, batch shape (B, K).

    Returns:
        The blocks, linear.
    """
    root = root_of(begin.covariance)
    centre, images = carry(begin, sigma_points(root, weights), blocks)
    moments = image_moments(images, weights)
    ahead = PointsAhead(centre, moments)
    tells = ahead.regressed(root)
    spread = symmetrized(moments.covariance + centre.noise)
    end = vehicle.moved(centre.belief, moments.shift, blocks)._replace(covariance=spread)
    found = measured_by_points(vehicle, weights, RootedBelief(end, root_of(spread)), blocks)
    noise = symmetrized(tells.unexplained + centre.noise)
    return LinearBlocks(begin, end, tells.slope, noise, found)


def extended_blocks(
    vehicle: Vehicle[Any], ahead: VehicleAhead, begin: Any, blocks: Any
) -> LinearBlocks:
    """Return all blocks as the extended filter sees them, which is where passes begin.

    Args:
        vehicle: The vehicle.
        ahead: All blocks predicted from the guess.
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).
        blocks: The blocks, batch shape (B, K).

    Returns:
        The blocks, linear.
    """
    end = ahead.belief
    return LinearBlocks(begin, end, ahead.transition, ahead.noise, vehicle.measured(end, blocks))


def filtered_blocks(
    vehicle: Vehicle[Any],
    start: Any,
    linear: LinearBlocks,
    blocks: Any,
    said: Judged | None,
    rounds: int,
) -> tuple[Ended, Behind]:
    """Filter all blocks behind the gate.

    Args:
        vehicle: The vehicle.
        start: Belief before the first block, batch shape (B,).
        linear: The blocks, linear.
        blocks: The blocks, batch shape (B, K).
        said: What to believe; None believes everything.
        rounds: How often at most that is renewed.

    Returns:
        Every block's end, batch shape (B, K), and what the gate said.
    """
    end, found = linear.end, linear.found
    behind = filtered_behind_gate(
        vehicle,
        start.covariance,
        start.refused,
        Linearised(linear.transition, _shift(vehicle, linear, blocks), linear.noise, found),
        said,
        rounds,
        lambda verdict, innovation: vehicle.opened(verdict, found, innovation),
    )
    filtered, judged = behind.filtered, behind.judged
    before = torch.cat((start.refused.unsqueeze(1), judged.refused[:, :-1]), 1)
    prior = vehicle.moved(end, filtered.prior_mean, blocks)
    after = vehicle.moved(end, filtered.mean, blocks)
    there = vehicle.rows.spread(found.present) > 0.5
    record = Ended(
        prior._replace(covariance=filtered.prior_covariance, refused=before),
        after._replace(covariance=filtered.covariance, refused=judged.refused),
        torch.where(there, behind.innovation, torch.nan),
        judged,
        torch.zeros_like(filtered.mean),
    )
    return record, behind


def _shift(vehicle: Vehicle[Any], linear: LinearBlocks, blocks: Any) -> Tensor:
    """Return by how much a block's end moves because the one before ends elsewhere, (B, K, n)."""
    before, there = map_tree((linear.end, blocks), lambda x: x[:, :-1])
    gap = vehicle.difference(before, map_tree(linear.begin, lambda x: x[:, 1:]), there)
    gap = torch.nn.functional.pad(gap, (0, 0, 1, 0))
    return (linear.transition @ gap.unsqueeze(-1)).squeeze(-1)
