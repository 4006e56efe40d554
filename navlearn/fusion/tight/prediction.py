"""A vehicle and a clock predicted over blocks."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ekf import propagated
from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.tight.clock import advanced_clock, clock_noise, clock_transition
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.passes import VehicleAhead
from navlearn.fusion.tight.update import with_covariance


class TightAhead(NamedTuple):
    """Blocks as predicted from a belief, with their linearisation there.

    Attributes:
        belief: Belief at the end, covariance as at the start, batch shape (...).
        transition: Φ, shape (..., n + c, n + c).
        noise: Q, shape (..., n + c, n + c).
    """

    belief: TightBelief[Any]
    transition: Tensor
    noise: Tensor


def tight_ahead(
    model: TightModel,
    belief: TightBelief[Any],
    block: Any,
    elapsed: Tensor,
    noise: TightNoise,
    *,
    in_turn: bool = False,
) -> TightAhead:
    """Return blocks as predicted, with their linearisation.

    Args:
        model: The filter.
        belief: Belief at the start of each block, batch shape (...).
        block: The vehicle's side of the blocks.
        elapsed: Length of each block, s, shape (...).
        noise: Noise of the clock.
        in_turn: Whether the vehicle goes sample by sample.

    Returns:
        Prediction; vehicle and clock do not touch each other.
    """
    predict = model.vehicle.predicted_in_turn if in_turn else model.vehicle.predicted
    return beside_clock(model, belief, predict(belief.vehicle, block), elapsed, noise)


def beside_clock(
    model: TightModel,
    belief: TightBelief[Any],
    ahead: VehicleAhead,
    elapsed: Tensor,
    noise: TightNoise,
) -> TightAhead:
    """Return blocks as predicted, from what the vehicle predicts.

    Args:
        model: The filter.
        belief: Belief at the start of each block, batch shape (...).
        ahead: The vehicle's prediction.
        elapsed: Length of each block, s, shape (...).
        noise: Noise of the clock.

    Returns:
        Prediction.
    """
    c = model.size - model.first_clock
    moved = belief._replace(vehicle=ahead.belief, clock=advanced_clock(belief.clock, elapsed))
    return TightAhead(
        moved,
        _beside(ahead.transition, clock_transition(elapsed, model.systems), c),
        _beside(ahead.noise, clock_noise(elapsed, model.systems, noise), c),
    )


def predicted_belief(ahead: TightAhead, covariance: Tensor) -> TightBelief[Any]:
    """Return a prediction with its covariance, Φ P Φᵀ + Q.

    Args:
        ahead: The prediction, batch shape (...).
        covariance: P at the start, shape (..., n + c, n + c).
    """
    return with_covariance(ahead.belief, propagated(covariance, ahead.transition, ahead.noise))


def _beside(vehicle: Tensor, clock: Tensor, c: int) -> Tensor:
    n = vehicle.shape[-1]
    wide = torch.nn.functional.pad(vehicle, (0, c, 0, c))
    return wide + torch.nn.functional.pad(clock, (n, 0, n, 0))
