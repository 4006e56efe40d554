"""Points of a full IMU carried over all blocks at once by what the samples sum up to.

A block's increments follow other sensor parameters to first order
([Forster2017] §VI, :mod:`navlearn.mechanization.preintegration`); all else of a point goes through
the closed formula of a window as it is. What first order leaves is of second order in the
deviations of gyros and accelerometers, so blocks at which these are not known yet are carried over
their samples.
"""

from typing import Any

from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.filters.unscented import SigmaWeights
from navlearn.fusion.ins.composed import has_closed_form
from navlearn.fusion.ins.fast_blocks import Sums, summed
from navlearn.fusion.ins.layout import moved_state
from navlearn.fusion.ins.noise import walks
from navlearn.fusion.tight.ins_vehicle import InsVehicle, apart_from_first
from navlearn.fusion.tight.trees import for_points
from navlearn.fusion.tight.vehicle import VehicleAhead
from navlearn.fusion.unscented.carry import carried_where, plain_carry
from navlearn.fusion.unscented.fast_pass import Carry
from navlearn.mechanization.preintegration import block_transition, corrected, predict
from navlearn.mechanization.preintegration_predict import predict_with_way

LEFT = 1e-6
"""What first order may leave of the mean velocity of a block's points, m/s."""


def ins_carry(vehicle: InsVehicle, weights: SigmaWeights) -> Carry:
    """Return what carries points by sums over the samples.

    Args:
        vehicle: The vehicle.
        weights: Weights of the points.
    """
    model = vehicle.model
    if not has_closed_form(model):
        return plain_carry(vehicle)

    def carry(begin: InsBelief, deviation: Tensor, blocks: Any) -> tuple[VehicleAhead, Tensor]:
        sums = summed(model, begin.sensor, blocks.samples, vehicle.noise)
        change, walk = begin.sensor - sums.sensor, walks(model.layout, vehicle.noise)
        state = predict(begin.state, sums.pre, change)
        linear = block_transition(begin.state, sums.pre, walk, change)
        images = apart_by_sums(begin, sums, deviation)
        wide = left_by_first_order(sums, deviation, weights) > LEFT
        if bool(wide.any()):
            images = carried_where(vehicle, wide, begin, deviation, blocks, images)
        return VehicleAhead(begin._replace(state=state), *linear), images

    return carry


def apart_by_sums(begin: InsBelief, sums: Sums, deviation: Tensor) -> Tensor:
    """Return how far from the first point others are at the ends of blocks.

    Args:
        begin: Beliefs at the starts of blocks, batch shape (...).
        sums: What the samples say.
        deviation: Points about the beliefs, the first zero, shape (..., P, n).

    Returns:
        Shape (..., P, n).
    """
    batch, points = deviation.dim() - 2, deviation.shape[-2]
    sensor = deviation[..., 9:]
    change = for_points(begin.sensor - sums.sensor, batch, points) + sensor
    start = moved_state(for_points(begin.state, batch, points), deviation)
    end, way = predict_with_way(start, corrected(for_points(sums.pre, batch, points), change))
    return apart_from_first(deviation, end, way, sensor)


def left_by_first_order(sums: Sums, deviation: Tensor, weights: SigmaWeights) -> Tensor:
    """Return what is wrong with the mean velocity of the points of blocks, m/s, shape (...).

    Args:
        sums: What the samples say.
        deviation: Points, shape (..., P, n).
        weights: Weights of the points.
    """
    pre, known = sums.pre, sums.pre.by_sensor.shape[-1]
    change = deviation[..., 9 : 9 + known].detach()
    moved = change @ pre.by_sensor.detach().transpose(-1, -2)
    turn, push = moved[..., 6:].norm(dim=-1), moved[..., 3:6].norm(dim=-1)
    speed = pre.velocity.detach().norm(dim=-1).unsqueeze(-1)
    left: Tensor = turn * (0.5 * turn * speed + push)
    return weights.each * left.sum(-1)
