"""How sigma points move through blocks.

Points are deviations in the order of the error state. The vehicle moves them, without any
linearisation, and process noise is that of its linear model at the mean [Ghouneem2024] (18)–(21).
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ekf import propagated
from navlearn.filters.regression import Regressed, regressed
from navlearn.filters.square_root import root_of, root_of_sum
from navlearn.filters.unscented import ImageMoments, SigmaWeights, image_moments, sigma_points
from navlearn.fusion.tight.vehicle import Vehicle, VehicleAhead


class RootedBelief(NamedTuple):
    """A belief and the root of its covariance.

    Attributes:
        belief: Belief, batch shape (...); its covariance is that of the root.
        root: Lower triangular S with S Sᵀ = P, shape (..., n, n).
    """

    belief: Any
    root: Tensor


def rooted(belief: Any) -> RootedBelief:
    """Return a belief with the root of its covariance.

    Args:
        belief: Belief, batch shape (...).
    """
    return RootedBelief(belief, root_of(belief.covariance))


def squared(belief: Any, root: Tensor) -> RootedBelief:
    """Return a belief whose covariance is that of a root.

    Args:
        belief: Belief, batch shape (...).
        root: S, shape (..., n, n).
    """
    return RootedBelief(belief._replace(covariance=root @ root.transpose(-1, -2)), root)


class PointsAhead(NamedTuple):
    """Blocks as sigma points go through them.

    Attributes:
        centre: The central point carried, with Φ and Q of the linear model there.
        moments: Mean and covariance of the points at the end, relative to the central one.
    """

    centre: VehicleAhead
    moments: ImageMoments

    def regressed(self, root: Tensor) -> Regressed:
        """Return Φ, the mean's shift and Ω as the points tell them.

        Args:
            root: Root with which the points were drawn, shape (..., n, n).
        """
        return regressed(root, self.moments, self.centre.transition)


def points_ahead(
    vehicle: Vehicle[Any], weights: SigmaWeights, start: RootedBelief, block: Any
) -> PointsAhead:
    """Return sigma points carried through blocks, all samples at once.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        start: Beliefs at the starts of blocks, batch shape (...).
        block: The blocks, batch shape (...).

    Returns:
        What the points tell, batch shape (...).
    """
    deviation = sigma_points(start.root, weights)
    images = vehicle.carried_apart(start.belief, deviation, block)
    return PointsAhead(vehicle.predicted(start.belief, block), image_moments(images, weights))


def predicted(
    vehicle: Vehicle[Any], weights: SigmaWeights, start: RootedBelief, block: Any
) -> RootedBelief:
    """Predict over blocks with points drawn at their starts.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        start: Beliefs at the starts of blocks, batch shape (...).
        block: The blocks, batch shape (...).

    Returns:
        Beliefs at their ends, before any measurement.
    """
    return _noisy(vehicle, points_ahead(vehicle, weights, start, block), block)


def predicted_in_turn(
    vehicle: Vehicle[Any], weights: SigmaWeights, start: RootedBelief, block: Any
) -> RootedBelief:
    """Predict over blocks with points drawn anew at every sample, as the textbook has it.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        start: Beliefs at the starts of blocks, batch shape (...).
        block: The blocks, batch shape (...).

    Returns:
        Beliefs at their ends, before any measurement.
    """
    at = start
    for sample in vehicle.in_samples(block):
        at = _noisy(vehicle, _over_sample(vehicle, weights, at, sample), sample)
    return at


def ahead_by_points(
    vehicle: Vehicle[Any],
    weights: SigmaWeights,
    start: RootedBelief,
    block: Any,
    *,
    in_turn: bool = False,
) -> VehicleAhead:
    """Return the prediction over blocks as a linear one: Φ regressed, and Ω beside Q.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        start: Beliefs at the starts of blocks, batch shape (...).
        block: The blocks, batch shape (...).
        in_turn: Whether points are drawn anew at every sample, not only at the blocks' starts.

    Returns:
        Mean at the end, covariance as at the start; Φ, and Ω + Q.
    """
    if not in_turn:
        return _linear(vehicle, points_ahead(vehicle, weights, start, block), start, block)
    at, noise = start, torch.zeros_like(start.root)
    eye = torch.eye(noise.shape[-1], dtype=noise.dtype, device=noise.device)
    whole = eye.expand(noise.shape)
    for sample in vehicle.in_samples(block):
        points = _over_sample(vehicle, weights, at, sample)
        ahead = _linear(vehicle, points, at, sample)
        whole = ahead.transition @ whole
        noise = propagated(noise, ahead.transition, ahead.noise)
        at = _noisy(vehicle, points, sample)
    end = at.belief._replace(covariance=start.belief.covariance)
    return VehicleAhead(end, whole, noise)


def _over_sample(
    vehicle: Vehicle[Any], weights: SigmaWeights, start: RootedBelief, sample: Any
) -> PointsAhead:
    images = vehicle.carried_apart(start.belief, sigma_points(start.root, weights), sample)
    centre = vehicle.predicted_in_turn(start.belief, sample)
    return PointsAhead(centre, image_moments(images, weights))


def _linear(
    vehicle: Vehicle[Any], points: PointsAhead, start: RootedBelief, block: Any
) -> VehicleAhead:
    tells, centre = points.regressed(start.root), points.centre
    moved = vehicle.moved(centre.belief, tells.shift, block)
    return VehicleAhead(moved, tells.slope, tells.unexplained + centre.noise)


def _noisy(vehicle: Vehicle[Any], ahead: PointsAhead, block: Any) -> RootedBelief:
    centre, moments = ahead
    root = root_of_sum(moments.slope, moments.bend, root_of(centre.noise))
    return squared(vehicle.moved(centre.belief, moments.shift, block), root)
