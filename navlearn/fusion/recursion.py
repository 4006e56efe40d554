"""The filter as a loop over blocks: predict one, update at its end, feed back, go on.

One loop serves the closed and the open filter. It carries the point at which the model is
linearised, the estimate's deviation from it, and the covariance. Closed: the deviation is fed
back into the point after every update, so it is zero between updates. Open: the point is the
mechanization running free, and the deviation is minus its estimated error.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.ekf import propagated
from navlearn.fusion.filter_model import FilterModel, fed_back, predict_blocks
from navlearn.fusion.gated_update import gated_update
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measured import Occasion
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.opening import opened
from navlearn.fusion.record import Ended, history, path_in_blocks
from navlearn.fusion.timeline import Timeline
from navlearn.fusion.updates import measured
from navlearn.states import RissSample, Trajectory

T = TypeVar("T")


class Carried(NamedTuple):
    """What the loop carries from block to block.

    Attributes:
        point: Where the model is linearised, with the covariance, batch shape (B,).
        deviation: Estimate minus point, shape (B, n).
    """

    point: Belief
    deviation: Tensor


PredictBlock = Callable[
    [FilterModel, Carried, RissSample, Tensor, EkfNoise], tuple[Carried, Trajectory | None]
]


def predict_composed(
    model: FilterModel,
    carried: Carried,
    samples: RissSample,
    acceleration: Tensor,
    noise: EkfNoise,
) -> tuple[Carried, Trajectory | None]:
    """Predict one block, all its samples at once.

    Args:
        model: The filter.
        carried: At the start of the block.
        samples: Samples of the block, shape (B, n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (B, n).
        noise: Noise densities.

    Returns:
        What is carried to the block's end; the trajectory inside is left to a later pass.
    """
    point = carried.point
    ahead = predict_blocks(model, point, samples, acceleration, noise)
    transition, q = ahead.linearised
    moved = point._replace(
        state=ahead.state,
        sensor=ahead.sensor,
        velocity_offset=ahead.velocity_offset,
        covariance=propagated(point.covariance, transition, q),
    )
    deviation = carried.deviation
    if not model.closed:
        deviation = (transition @ deviation.unsqueeze(-1)).squeeze(-1)
    return Carried(moved, deviation), None


def end_block(
    model: FilterModel, carried: Carried, occasion: Occasion, noise: EkfNoise
) -> tuple[Carried, Ended]:
    """Update at the end of a block.

    Args:
        model: The filter.
        carried: Prediction at the block's end.
        occasion: What there is to measure, shape (B,) each.
        noise: Deviations of measurements.

    Returns:
        What is carried on, and the record of this end.
    """
    point, deviation = carried
    prior = point if model.closed else fed_back(model, point, deviation, occasion.end)
    found = measured(model.measurement, point, occasion, noise)
    innovation = found.innovation
    if not model.closed:
        innovation = innovation - (found.observation @ deviation.unsqueeze(-1)).squeeze(-1)
    found = found._replace(innovation=innovation)
    new, verdict = gated_update(
        model, point.covariance, point.refused, found, lambda v: opened(model, v, found, innovation)
    )
    point = point._replace(covariance=new.covariance, refused=verdict.refused)
    there = model.rows.spread(found.present) > 0.5
    shown = torch.where(there, innovation, torch.nan)
    if model.closed:
        belief = fed_back(model, point, new.correction, occasion.end)
        return Carried(belief, deviation), Ended(prior, belief, shown, verdict, deviation)
    deviation = deviation + new.correction
    belief = fed_back(model, point, deviation, occasion.end)
    return Carried(point, deviation), Ended(prior, belief, shown, verdict, deviation)


def run_loop(
    model: FilterModel,
    start: Belief,
    line: Timeline,
    noise: EkfNoise,
    predict: PredictBlock,
    method: str,
) -> FilterHistory:
    """Run the filter block after block.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise densities and deviations.
        predict: How a block is predicted.
        method: Name of that, for the record.

    Returns:
        History.
    """
    # unbind: indexing inside the loop would make the backward pass quadratic in K
    samples = zip(*(channel.unbind(1) for channel in line.samples), strict=True)
    acceleration = line.acceleration.unbind(1)
    occasions = unstacked(line.occasion)
    carried = Carried(start, torch.zeros_like(start.covariance[..., 0]))
    ends: list[Ended] = []
    inside: list[Trajectory] = []
    for k, block in enumerate(samples):
        carried, path = predict(model, carried, RissSample(*block), acceleration[k], noise)
        if path is not None:
            inside.append(path)
        carried, ended = end_block(model, carried, occasions[k], noise)
        ends.append(ended)
    record: Ended = stacked(ends)
    if inside:
        path = Trajectory(*(torch.stack(list(c), 1) for c in zip(*inside, strict=True)))
    else:
        path = path_in_blocks(model, start, record.belief, line)
    return history(line, record, path, method, 1)


def unstacked(occasion: T) -> list[T]:
    """Return what stands at each block, unbound at once; the inverse of :func:`stacked`.

    Args:
        occasion: Tree of named tuples of tensors, shape (B, K, ...) each.

    Returns:
        One tree per block.
    """
    leaves: list[list[Tensor]] = []

    def split(value: Any) -> Any:
        if value is None:
            return None
        if isinstance(value, Tensor):
            leaves.append(list(value.unbind(1)))
            return len(leaves) - 1
        return type(value)(*(split(x) for x in value))

    tree = split(occasion)

    def at(node: Any, k: int) -> Any:
        if node is None:
            return None
        return leaves[node][k] if isinstance(node, int) else type(node)(*(at(x, k) for x in node))

    return [at(tree, k) for k in range(len(leaves[0]))]


def stacked(items: list[Any]) -> Any:
    """Return trees of tensors, one per block, as one tree with an axis of blocks.

    Args:
        items: Trees of named tuples of tensors, shape (B, ...) each.

    Returns:
        Tree of tensors, shape (B, K, ...) each.
    """
    if items[0] is None:
        return None
    if isinstance(items[0], Tensor):
        return torch.stack(items, 1)
    return type(items[0])(*(stacked(list(column)) for column in zip(*items, strict=True)))
