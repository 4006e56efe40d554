"""What a tightly coupled filter believes before the first range."""

from typing import Any

import torch

from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.tight.clock import initial_clock_variance
from navlearn.fusion.tight.model import TightModel


def tight_start(model: TightModel, vehicle: Any, satellites: int) -> TightBelief[Any]:
    """Return a belief of a vehicle with a clock of which nothing is known.

    Args:
        model: The filter.
        vehicle: Belief of the vehicle, batch shape (...).
        satellites: Number S of satellites.

    Returns:
        Belief, batch shape (...).
    """
    covariance = vehicle.covariance
    variance = initial_clock_variance(model.options.clock, model.systems, covariance)
    c, n = len(variance), model.first_clock
    wide = torch.nn.functional.pad(covariance, (0, c, 0, c))
    clock = torch.nn.functional.pad(torch.diag(variance), (n, 0, n, 0))
    shape = covariance.shape[:-2]
    return TightBelief(
        vehicle,
        covariance.new_zeros((*shape, c)),
        wide + clock,
        covariance.new_zeros((*shape, 2 * satellites + 2)),
    )
