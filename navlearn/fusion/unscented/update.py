"""What sigma points tell of measurements, and the update by it.

Statistical linear regression of the vehicle's own measurement functions: a Kalman update with the
regressed H, and with Ω beside R, is the unscented update [GarciaFernandez2015], behind the gate
that all filters have.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.filters.regression import regressed
from navlearn.filters.square_root import root_of, root_of_sum, updated_root
from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import SigmaWeights, image_moments, sigma_points
from navlearn.fusion.gated_update import believed
from navlearn.fusion.gating import Judged
from navlearn.fusion.measured import Measured
from navlearn.fusion.tight.trees import for_points
from navlearn.fusion.tight.vehicle import Vehicle
from navlearn.fusion.unscented.prediction import RootedBelief, squared


class Updated(NamedTuple):
    """What an update gives.

    Attributes:
        after: Belief after the update, errors fed back.
        judged: What the gate said.
    """

    after: RootedBelief
    judged: Judged


def measured_by_points(
    vehicle: Vehicle[Any], weights: SigmaWeights, prior: RootedBelief, block: Any
) -> Measured:
    """Return what is measured, H regressed on sigma points and Ω beside R.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
        prior: Predictions at the ends of blocks, batch shape (...).
        block: The blocks, batch shape (...).

    Returns:
        Innovations against the mean of the predicted measurements, shape (...).
    """
    deviation = sigma_points(prior.root, weights)
    seen = measured_at_points(vehicle, prior.belief, deviation, block)
    found = of_first(seen, deviation.dim() - 2)
    if not bool((found.present > 0.5).any()):
        return found
    images, told = images_of(vehicle, deviation, found, seen)
    tells = regressed(prior.root, image_moments(images, weights), found.observation)
    bend = torch.where(told.unsqueeze(-1), tells.bend, 0.0)
    return found._replace(
        innovation=torch.where(told, found.innovation - tells.shift, found.innovation),
        observation=torch.where(told.unsqueeze(-1), tells.slope, found.observation),
        extra=bend @ bend.transpose(-1, -2),
    )


def measured_at_points(
    vehicle: Vehicle[Any], belief: Any, deviation: Tensor, block: Any
) -> Measured:
    """Return what points about predictions measure, their position that of the first.

    Args:
        vehicle: The vehicle.
        belief: Predictions at the ends of blocks, batch shape (...).
        deviation: Points about them, the first zero, shape (..., P, n).
        block: The blocks, batch shape (...).

    Returns:
        Batch shape (..., P).
    """
    batch, points = deviation.dim() - 2, deviation.shape[-2]
    wide = for_points(block, batch, points)
    rest = torch.nn.functional.pad(deviation[..., 3:], (3, 0))
    at = vehicle.moved(for_points(belief, batch, points), rest, wide)
    return vehicle.measured(at, wide)


def of_first(seen: Measured, batch: int) -> Measured:
    """Return what the first point measures, which is the prediction itself.

    Args:
        seen: What is measured at points, batch shape (..., P).
        batch: Number of batch axes before the points'.
    """
    found: Measured = map_tree(seen, lambda x: x.select(batch, 0))
    return found


def images_of(
    vehicle: Vehicle[Any], deviation: Tensor, found: Measured, seen: Measured
) -> tuple[Tensor, Tensor]:
    """Return predicted measurements relative to the first point's, and where all points have one.

    A position enters as it is: its part is taken from H, as latitudes would keep a nanometre of it,
    of which narrow points make centimetres.

    Args:
        vehicle: The vehicle.
        deviation: Points about predictions, the first zero, shape (..., P, n).
        found: What is measured at the predictions.
        seen: What is measured at the points, batch shape (..., P).

    Returns:
        Shape (..., P, r), and bool, shape (..., r).
    """
    position = deviation[..., :3]
    by_position = position @ found.observation[..., :3].transpose(-1, -2)
    images = by_position - (seen.innovation - seen.innovation[..., :1, :])
    for row in vehicle.angle_rows:
        line = (deviation @ found.observation[..., row, :].unsqueeze(-1)).squeeze(-1)
        near = line + wrap_angle(images[..., row] - line)
        images = torch.cat((images[..., :row], near.unsqueeze(-1), images[..., row + 1 :]), -1)
    told = vehicle.rows.spread((seen.present > 0.5).all(-2))
    return images, told


def updated(vehicle: Vehicle[Any], prior: RootedBelief, found: Measured, block: Any) -> Updated:
    """Update behind the gate, on the root of the covariance.

    Args:
        vehicle: The vehicle.
        prior: Predictions at the ends of blocks, batch shape (...).
        found: What is measured, as :func:`measured_by_points` returns it.
        block: The blocks, batch shape (...).

    Returns:
        Beliefs after the update, and what the gate said.
    """
    belief, root = prior
    image = found.observation @ root
    spread = image @ image.transpose(-1, -2)
    passed = believed(
        vehicle, spread, belief.refused, found, lambda v: vehicle.opened(v, found, found.innovation)
    )
    if passed.opened is not None:
        there = passed.opened > 0.0
        sigma = torch.where(there, torch.where(there, passed.opened, 1.0).sqrt(), 0.0)
        root = root_of_sum(root, torch.diag_embed(sigma))
    used = passed.used
    noise = torch.diag_embed(used.variance.sqrt())
    if used.extra is not None:
        noise = root_of(torch.diag_embed(used.variance) + used.extra)
    new = updated_root(root, used.observation, noise, used.innovation)
    belief = vehicle.moved(belief, new.correction, block)
    return Updated(squared(belief._replace(refused=passed.judged.refused), new.root), passed.judged)
