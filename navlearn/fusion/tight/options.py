"""Choices of the tightly coupled filter.

Figures of the clock are those of an ordinary temperature-compensated crystal: with Allan-variance
coefficients h₀ = 2·10⁻¹⁹ s and h₋₂ = 2·10⁻²⁰ Hz the densities c √(h₀/2) and c π √(2 h₋₂) are
0.09 m/√s and 0.19 m/s/√s, rounded up here.
"""

import math
from dataclasses import dataclass, field, fields

from navlearn.errors import ConfigError
from navlearn.gnss.range_noise import RangeNoiseOptions


@dataclass(frozen=True, kw_only=True)
class ClockOptions:
    """The receiver's clock, times the speed of light, and the times of further systems.

    Attributes:
        frequency_noise: White frequency noise: how the bias walks, m/√s.
        frequency_walk: Random-walk frequency noise: how the drift walks, m/s/√s.
        offset_walk: How the time of a further system walks against the first, m/√s.
        initial_bias: Deviation of the bias at the start, m.
        initial_drift: Deviation of the drift at the start, m/s; 300 m/s are 1 ppm.
        initial_offset: Deviation of the time of a further system at the start, m.
    """

    frequency_noise: float = 0.1
    frequency_walk: float = 0.2
    offset_walk: float = 0.005
    initial_bias: float = 1e4
    initial_drift: float = 1000.0
    initial_offset: float = 1e4

    def __post_init__(self) -> None:
        """Refuse deviations that are none.

        Raises:
            ConfigError: If an entry is negative or not finite, or one at the start zero.
        """
        _check_figures("ClockOptions", self, positive=("initial",))


@dataclass(frozen=True, kw_only=True)
class RangeGateOptions:
    """When a satellite is refused, and when the clock or the position begins anew.

    The rules are told in :mod:`navlearn.fusion.tight.integrity`.

    Attributes:
        probability: Share of good measurements that pass; 1 switches the gate off.
        reset_after: Receptions in a row many of whose satellites must have been refused before
            position begins anew, or a clock that did not visibly jump.
        least_satellites: Fewest ranges of one system that may begin position anew.
        redundant: By how many more that wants to be confirmed, where they are there.
        unknown_clock: A bias or offset less certain than this is unknown, m: it is set to what the
            satellites agree on before they are judged.
        smallest_jump: Offset on which most satellites must agree for a jump of the clock's bias to
            be believed at once, m.
        smallest_drift_jump: The same of its drift, m/s.
        anew_clock: Deviation with which a bias or an offset begins anew, m.
        anew_drift: The same of the drift, m/s.
        anew_position: The same of position, m; more where ranges are farther off.
        anew_velocity: The same of velocity states, m/s.
    """

    probability: float = 0.999
    reset_after: int = 10
    least_satellites: int = 4
    redundant: int = 2
    unknown_clock: float = 3e3
    smallest_jump: float = 150.0
    smallest_drift_jump: float = 3.0
    anew_clock: float = 1e3
    anew_drift: float = 100.0
    anew_position: float = 1e3
    anew_velocity: float = 50.0

    def __post_init__(self) -> None:
        """Refuse a gate that cannot be.

        Raises:
            ConfigError: If an entry is outside its range.
        """
        _check_figures("RangeGateOptions", self, positive=("anew", "probability", "unknown"))
        if self.probability > 1.0:
            raise ConfigError(
                f"RangeGateOptions.probability: found {self.probability}; expected in (0, 1]"
            )
        if self.least_satellites < 4:
            raise ConfigError(
                f"RangeGateOptions.least_satellites: found {self.least_satellites}; expected 4 or "
                "more: fewer ranges do not tell a position and a clock"
            )


@dataclass(frozen=True, kw_only=True)
class TightEkfOptions:
    """Choices of the tightly coupled filter beside those of its vehicle.

    Attributes:
        range_noise: How noisy a pseudorange and a range rate are.
        clock: The receiver's clock.
        gate: When a satellite is refused.
        elevation_mask: Satellites below this elevation are not used, rad.
        least_cn0: Satellites received with less are not used, dB-Hz.
        use_rates: Whether range rates are used.
    """

    range_noise: RangeNoiseOptions = field(default_factory=RangeNoiseOptions)
    clock: ClockOptions = field(default_factory=ClockOptions)
    gate: RangeGateOptions = field(default_factory=RangeGateOptions)
    elevation_mask: float = math.radians(7.5)
    least_cn0: float = 20.0
    use_rates: bool = True

    def __post_init__(self) -> None:
        """Refuse a mask that is no angle.

        Raises:
            ConfigError: If the mask is outside ±90°, or the least C/N0 is not finite.
        """
        if not abs(self.elevation_mask) <= 0.5 * math.pi:
            raise ConfigError(
                f"TightEkfOptions.elevation_mask: found {self.elevation_mask}; expected radians "
                "within ±π/2: convert degrees with math.radians"
            )
        if not math.isfinite(self.least_cn0):
            raise ConfigError(
                f"TightEkfOptions.least_cn0: found {self.least_cn0}; expected a finite figure in "
                "dB-Hz: 0 takes every satellite"
            )


def _check_figures(name: str, options: object, *, positive: tuple[str, ...]) -> None:
    for entry in fields(options):  # type: ignore[arg-type]
        value = getattr(options, entry.name)
        above = entry.name.startswith(positive)
        if not 0.0 <= value < math.inf or (above and value == 0.0):
            raise ConfigError(
                f"{name}.{entry.name}: found {value}; expected a finite value "
                + ("above 0" if above else "of 0 or more")
            )
