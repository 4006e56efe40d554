"""When a filter believes a measurement."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """When a measurement is refused.

    Attributes:
        probability: Share of good measurements that pass; 1 switches the gate off.
        reset_after: After so many refusals in a row of one kind the next is taken, with a
            covariance opened to its innovation, so that a drifted filter cannot lock itself out.
        reset_azimuth: Azimuth deviation added at such a reset, rad.
    """

    probability: float = 0.999
    reset_after: int = 10
    reset_azimuth: float = math.radians(10.0)
