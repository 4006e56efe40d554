"""What a user may choose about positions from ranges alone."""

import math
from dataclasses import dataclass, field

from navlearn.errors import ConfigError
from navlearn.gnss.range_noise import RangeNoiseOptions


@dataclass(frozen=True, kw_only=True)
class SinglePointOptions:
    """Choices of single-point positions and range-rate velocities.

    Test and robust weights were chosen on simulated drives of the presets ``suburban`` and
    ``urban``, where they took the 95 % error from 3.5 to 2.5 m and from 23 to 14 m with GPS, and
    with three systems from 11 to 4 m in the town.

    Attributes:
        noise: How noisy ranges and range rates are.
        elevation_mask: Satellites lower than this are not used, rad.
        probability: Share of sound receptions that pass the residual test; 1 switches the test,
            and exclusion with it, off.
        exclusions: Most satellites that may be excluded from one reception.
        huber: What is left after exclusion counts less in proportion where its residual is more
            deviations than this off [Huber2009]; infinite makes it least squares.
        largest_pdop: A worse geometry gives no position, and no velocity.
        heights: A position lower or higher than these above the ellipsoid is refused, m.
        fastest: A velocity of this size or more is refused, m/s.
        iterations: Most Gauss–Newton steps; from the Earth's centre 6 suffice.
    """

    noise: RangeNoiseOptions = field(default_factory=RangeNoiseOptions)
    elevation_mask: float = math.radians(10.0)
    probability: float = 0.99
    exclusions: int = 4
    huber: float = 1.345
    largest_pdop: float = 30.0
    heights: tuple[float, float] = (-1000.0, 20000.0)
    fastest: float = 150.0
    iterations: int = 15

    def __post_init__(self) -> None:
        """Refuse what has no meaning.

        Raises:
            ConfigError: An entry lies outside its range.
        """
        low, high = self.heights
        for name, sound, expected in (
            ("elevation_mask", abs(self.elevation_mask) < 0.5 * math.pi, "within ±90°, in rad"),
            ("probability", 0.0 < self.probability <= 1.0, "in (0, 1]"),
            ("exclusions", self.exclusions >= 0, "0 or more"),
            ("huber", self.huber > 0.0, "above 0"),
            ("largest_pdop", self.largest_pdop > 0.0, "above 0"),
            ("heights", low < high, "lowest before highest"),
            ("fastest", self.fastest > 0.0, "above 0"),
            ("iterations", self.iterations >= 1, "1 or more"),
        ):
            if not sound:
                raise ConfigError(
                    f"single point: {name} is {getattr(self, name)!r}; expected {expected}"
                )
