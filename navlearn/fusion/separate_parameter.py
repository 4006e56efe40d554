"""One more constant parameter of a sensor, estimated from two runs of a filter.

A constant that has no noise of its own needs no state: innovations and estimates depend on it
linearly. A second run, over samples from which a known amount of it was taken off, tells how; the
constant is then a least-squares fit of the first run's innovations on their change, and the
belief with it a combination of the two runs' beliefs. [Friedland1969]
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.filters.belief import Belief
from navlearn.fusion.error_state import position_difference
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measurements import Verdict

FEWEST = 10
"""Innovations of a row before their spread is known well enough to weigh them."""


class SeparateParameter(NamedTuple):
    """A parameter as it was known after every block, and the beliefs with it.

    Attributes:
        value: Estimate, unit of the amount that was taken off, shape (K,).
        sigma: Its standard deviation, shape (K,).
        belief: Belief with the parameter removed, batch shape (K,).
    """

    value: Tensor
    sigma: Tensor
    belief: Belief


def separate_parameter(
    model: FilterModel, raw: FilterHistory, less: FilterHistory, amount: float, prior: float
) -> SeparateParameter:
    """Return a parameter from a run without it and one with some of it taken off.

    Every estimate rests on what came before it alone.

    Args:
        model: The filter of both runs, with closed feedback.
        raw: Run over the samples as they are, no batch axis.
        less: Run over samples from which ``amount`` of the parameter was taken off.
        amount: How much that was, in the parameter's unit; not zero.
        prior: Standard deviation of the parameter about zero before the drive.

    Returns:
        Estimates and beliefs.

    Raises:
        ShapeError: The runs do not have the same blocks.
    """
    if not torch.equal(raw.end, less.end):
        raise ShapeError(
            f"separate parameter: runs of {len(raw.end)} and {len(less.end)} blocks; expected "
            "two runs over one drive, with blocks that end at the same samples"
        )
    # neither resets nor outliers tell a parameter
    accepted = int(Verdict.ACCEPTED)
    fine = (raw.verdict == accepted) & (less.verdict == accepted)
    used = model.rows.spread(fine) & torch.isfinite(raw.innovation + less.innovation)
    innovation = torch.where(used, raw.innovation, 0.0)
    change = torch.where(used, (raw.innovation - less.innovation) / amount, 0.0)
    count = torch.cumsum(used.to(innovation), 0)
    spread = torch.cumsum(innovation.square(), 0) / count.clamp(min=1.0)
    weight = torch.where((count >= FEWEST) & (spread > 0.0), 1.0 / spread, 0.0)
    told = torch.cumsum((weight * change * innovation).sum(-1), 0)
    known = torch.cumsum((weight * change.square()).sum(-1), 0) + 1.0 / prior**2
    value, sigma = told / known, known.rsqrt()
    return SeparateParameter(value, sigma, _combined(model, raw, less, amount, value, sigma))


def _combined(
    model: FilterModel,
    raw: FilterHistory,
    less: FilterHistory,
    amount: float,
    value: Tensor,
    sigma: Tensor,
) -> Belief:
    """Return the beliefs between, or beyond, those of two runs."""
    share = value / amount

    def mixed(a: Tensor, b: Tensor) -> Tensor:
        return a + (b - a) * share.view(-1, *([1] * (a.dim() - 1)))

    one, other = raw.belief, less.belief
    position = position_difference(other.state, one.state)
    turn = (other.state.azimuth - one.state.azimuth).unsqueeze(-1)
    parts = [position, turn, other.sensor - one.sensor]
    if model.layout.has_velocity:
        parts.insert(1, other.velocity_offset - one.velocity_offset)
    effect = torch.cat(parts, -1) / amount * sigma.unsqueeze(-1)
    return one._replace(
        state=type(one.state)(*map(mixed, one.state, other.state)),
        sensor=mixed(one.sensor, other.sensor),
        anchor=mixed(one.anchor, other.anchor),
        velocity_offset=mixed(one.velocity_offset, other.velocity_offset),
        covariance=one.covariance + effect.unsqueeze(-1) * effect.unsqueeze(-2),
    )
