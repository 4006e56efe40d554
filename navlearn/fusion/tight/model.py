"""One tightly coupled filter's choices made ready."""

from dataclasses import dataclass
from typing import Any

from navlearn.filters.consistency import chi_square_quantile
from navlearn.fusion.tight.clock import clock_names
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.vehicle import Vehicle

SURPRISES = 3
"""Columns behind the error states: what an antenna's velocity does beside them."""


@dataclass(frozen=True)
class TightModel:
    """A filter's choices made ready.

    Attributes:
        vehicle: What carries the antenna.
        options: Choices beside those of the vehicle.
        systems: Number of satellite systems.
        limit: Largest NIS of a single measurement that the gate lets pass.
    """

    vehicle: Vehicle[Any]
    options: TightEkfOptions
    systems: int
    limit: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all error states, in order."""
        return (*self.vehicle.names, *clock_names(self.systems))

    @property
    def first_clock(self) -> int:
        """Place of the clock's bias in the error state: the number n of the vehicle's states."""
        return len(self.vehicle.names)

    @property
    def size(self) -> int:
        """Number n + c of error states."""
        return len(self.names)


def tight_model(vehicle: Vehicle[Any], options: TightEkfOptions, systems: int) -> TightModel:
    """Return a filter's choices made ready.

    Args:
        vehicle: What carries the antenna.
        options: Choices beside those of the vehicle.
        systems: Number of satellite systems.

    Returns:
        Model.
    """
    return TightModel(vehicle, options, systems, chi_square_quantile(options.gate.probability, 1))
