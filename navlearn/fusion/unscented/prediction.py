"""How sigma points move through blocks.

Points are deviations in the order of the error state. The vehicle moves them, without any
linearisation, and process noise is that of its linear model at the mean [Ghouneem2024] (18)–(21).
"""

from typing import Any, NamedTuple

from torch import Tensor

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
        images = vehicle.carried_apart(at.belief, sigma_points(at.root, weights), sample)
        centre = vehicle.predicted_in_turn(at.belief, sample)
        at = _noisy(vehicle, PointsAhead(centre, image_moments(images, weights)), sample)
    return at


def _noisy(vehicle: Vehicle[Any], ahead: PointsAhead, block: Any) -> RootedBelief:
    centre, moments = ahead
    root = root_of_sum(moments.slope, moments.bend, root_of(centre.noise))
    return squared(vehicle.moved(centre.belief, moments.shift, block), root)
