"""What is measured at the end of a block, as the rows by which it is judged and taken."""

from collections.abc import Callable
from typing import Any, NamedTuple

from torch import Tensor

from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.measured import Measured
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.ranges import measured_ranges, with_surprise
from navlearn.fusion.tight.timeline import Reception


class Seen(NamedTuple):
    """What is measured at the end of a block, as rows of error states and of what lies beside them.

    Attributes:
        own: What the vehicle measures of itself, H in the first w of these columns, w ≥ n.
        ranges: What ranges say, H in all N of them.
        covariance: That of error states and of what lies beside them, shape (..., N, N).
    """

    own: Measured
    ranges: Measured
    covariance: Tensor


See = Callable[[TightModel, TightBelief[Any], Any, Reception, TightNoise], Seen]
"""How a filter sees what is measured, from its prediction at a block's end."""


def seen_linearly(
    model: TightModel,
    prior: TightBelief[Any],
    block: Any,
    reception: Reception,
    noise: TightNoise,
) -> Seen:
    """Return what is measured, linearised at the prediction.

    Args:
        model: The filter.
        prior: Prediction at the block's end, batch shape (...).
        block: The vehicle's side of the block.
        reception: What was received, shape (...).
        noise: Noise of ranges.

    Returns:
        What is measured.
    """
    antenna = model.vehicle.antenna(prior.vehicle, block, reception.delay)
    found = measured_ranges(antenna, prior.clock, reception, noise)
    own = model.vehicle.measured(prior.vehicle, block)
    return Seen(own, found, with_surprise(prior.covariance, antenna))
