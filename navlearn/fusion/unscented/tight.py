"""The tightly coupled filter by sigma points: the steps of its loop over blocks.

The clock is linear in motion and measurement, so points are drawn of the vehicle alone, and what
they tell stands beside the clock's own transition and columns: with the vehicle's points as few as
without satellites, zero satellites make it the loosely coupled filter. What no linear function of
the points explains of ranges and of the vehicle's own measurements is one more thing that lies
beside the error states, as the surprises of :mod:`navlearn.fusion.tight.ranges` do: H has a column
for each of n unit deviations, whose covariance is one.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.filters.regression import regressed
from navlearn.filters.tight_belief import TightBelief
from navlearn.filters.unscented import (
    SigmaWeights,
    UnscentedOptions,
    image_moments,
    sigma_points,
    sigma_weights,
)
from navlearn.fusion.measured import Measured
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.prediction import TightAhead, beside_clock
from navlearn.fusion.tight.ranges import measured_ranges, with_surprise
from navlearn.fusion.tight.seen import Seen
from navlearn.fusion.tight.steps import TightSteps
from navlearn.fusion.tight.timeline import Reception
from navlearn.fusion.tight.trees import for_points
from navlearn.fusion.tight.vehicle import Antenna
from navlearn.fusion.unscented.prediction import ahead_by_points, rooted
from navlearn.fusion.unscented.update import images_of, measured_at_points, of_first


def unscented_steps(model: TightModel, options: UnscentedOptions) -> TightSteps:
    """Return the steps of a tightly coupled filter by sigma points.

    Args:
        model: The filter.
        options: Spread and weights of the points.

    Returns:
        How it predicts and sees.
    """
    weights = sigma_weights(options, model.first_clock)

    def ahead(
        model: TightModel,
        belief: TightBelief[Any],
        block: Any,
        elapsed: Tensor,
        noise: TightNoise,
        *,
        in_turn: bool = False,
    ) -> TightAhead:
        start = rooted(belief.vehicle)
        of_vehicle = ahead_by_points(model.vehicle, weights, start, block, in_turn=in_turn)
        return beside_clock(model, belief, of_vehicle, elapsed, noise)

    def see(
        model: TightModel,
        prior: TightBelief[Any],
        block: Any,
        reception: Reception,
        noise: TightNoise,
    ) -> Seen:
        return seen_by_points(model, weights, prior, block, reception, noise)

    return TightSteps(ahead, see)


def seen_by_points(
    model: TightModel,
    weights: SigmaWeights,
    prior: TightBelief[Any],
    block: Any,
    reception: Reception,
    noise: TightNoise,
) -> Seen:
    """Return what is measured, H regressed on sigma points.

    Args:
        model: The filter.
        weights: Weights of the vehicle's points.
        prior: Prediction at the block's end, batch shape (...).
        block: The vehicle's side of the block.
        reception: What was received, shape (...).
        noise: Noise of ranges.

    Returns:
        What is measured; the columns are error states, surprises, and what is left of the points.
    """
    vehicle, n = model.vehicle, model.first_clock
    antenna = vehicle.antenna(prior.vehicle, block, reception.delay)
    found = measured_ranges(antenna, prior.clock, reception, noise)
    at = rooted(prior.vehicle)
    deviation = sigma_points(at.root, weights)
    by_points = measured_at_points(vehicle, prior.vehicle, deviation, block)
    own = of_first(by_points, deviation.dim() - 2)
    images, told = images_of(vehicle, deviation, own, by_points)
    far = _range_images(model, prior, deviation, block, reception, noise)
    by_state = torch.cat((own.observation, found.observation[..., :n]), -2)
    moments = image_moments(torch.cat((images, far), -1), weights)
    tells = regressed(at.root, moments, by_state)
    rows = own.innovation.shape[-1]
    all_told = torch.cat((told, found.present > 0.5), -1)
    shift = torch.where(all_told, tells.shift, 0.0)
    slope = torch.where(all_told.unsqueeze(-1), tells.slope, by_state)
    bend = torch.where(all_told.unsqueeze(-1), tells.bend, 0.0)
    beside = found.observation[..., n:]
    unmoved = beside.new_zeros((*own.innovation.shape, beside.shape[-1]))
    eye = torch.eye(n, dtype=bend.dtype, device=bend.device)
    wide = with_surprise(prior.covariance, antenna)
    size = wide.shape[-1]
    return Seen(
        own._replace(
            innovation=own.innovation - shift[..., :rows],
            observation=torch.cat((slope[..., :rows, :], unmoved, bend[..., :rows, :]), -1),
        ),
        found._replace(
            innovation=found.innovation - shift[..., rows:],
            observation=torch.cat((slope[..., rows:, :], beside, bend[..., rows:, :]), -1),
        ),
        torch.nn.functional.pad(wide, (0, n, 0, n)) + torch.nn.functional.pad(eye, (size, 0) * 2),
    )


def _range_images(
    model: TightModel,
    prior: TightBelief[Any],
    deviation: Tensor,
    block: Any,
    reception: Reception,
    noise: TightNoise,
) -> Tensor:
    """Return predicted ranges and range rates of points relative to the first, (..., P, 2 S)."""
    batch, points = deviation.dim() - 2, deviation.shape[-2]
    heard, wide = for_points(reception, batch, points), for_points(block, batch, points)
    at = model.vehicle.moved(for_points(prior.vehicle, batch, points), deviation, wide)
    antenna: Antenna = model.vehicle.antenna(at, wide, heard.delay)
    clock = for_points(prior.clock, batch, points)
    seen: Measured = measured_ranges(antenna, clock, heard, noise)
    return seen.innovation[..., :1, :] - seen.innovation
