"""What is to go wrong with the fixes of a drive, and how often."""

import math
from dataclasses import dataclass, fields

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Spikes:
    """Single fixes that are off in a random horizontal direction.

    Attributes:
        sizes: Horizontal sizes, m; each fault draws one of them.
        per_hour: How many begin per hour of fixes, on average, before those too near to another
            fault are left out.
        vertical: Offset upwards or downwards over the horizontal one.
        velocity: By how much the velocity is off in the same direction, m/s; 0 leaves it right.
        honest: Whether the receiver's stated deviations grow by the offset.
    """

    sizes: tuple[float, ...] = (20.0,)
    per_hour: float = 30.0
    vertical: float = 0.0
    velocity: float = 0.0
    honest: bool = False


@dataclass(frozen=True, kw_only=True)
class Biases(Spikes):
    """Steps: for a stretch all fixes are off by the same.

    Attributes:
        durations: Lengths of the stretches, s; each fault draws one of them.
    """

    per_hour: float = 6.0
    durations: tuple[float, ...] = (30.0,)


@dataclass(frozen=True, kw_only=True)
class Ramps:
    """An offset that grows steadily, as a spoofer leads a receiver away, and then is gone.

    Attributes:
        sizes: Horizontal sizes at the end, m; each fault draws one of them.
        durations: Times of growth, s; each fault draws one of them.
        per_hour: How many begin per hour of fixes, as for spikes.
        vertical: Offset upwards or downwards over the horizontal one.
        velocity: Whether the velocity is off by the rate of growth, so that position and velocity
            tell one story; else it stays right.
        honest: Whether the receiver's stated deviations grow by the offset.
    """

    sizes: tuple[float, ...] = (50.0,)
    durations: tuple[float, ...] = (60.0,)
    per_hour: float = 4.0
    vertical: float = 0.0
    velocity: bool = False
    honest: bool = False


@dataclass(frozen=True, kw_only=True)
class Freezes:
    """The receiver repeats its last position.

    Attributes:
        durations: Lengths of the stretches, s; each fault draws one of them.
        per_hour: How many begin per hour of fixes, as for spikes.
        velocity: Whether the velocity is repeated, too; else it stays right.
    """

    durations: tuple[float, ...] = (20.0,)
    per_hour: float = 4.0
    velocity: bool = False


Offset = Spikes | Biases | Ramps
Fault = Offset | Freezes

KINDS: dict[str, type[Fault]] = {
    "spikes": Spikes,
    "biases": Biases,
    "ramps": Ramps,
    "freezes": Freezes,
}
"""Kinds of fault by the name of their field in :class:`FaultOptions`."""


@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """What goes wrong with the fixes of a drive; a kind that is None does not happen.

    Attributes:
        spikes: Single fixes that are off.
        biases: Stretches that are off by a step.
        ramps: Stretches that are led away.
        freezes: Stretches through which a position is repeated.
        settle: So long after the first fix nothing goes wrong, s.
        apart: So long after the end of a fault no other begins, s.
        seed: Seed of every draw, not negative; a kind that is added or left out changes no draw
            of the others.
    """

    spikes: Spikes | None = None
    biases: Biases | None = None
    ramps: Ramps | None = None
    freezes: Freezes | None = None
    settle: float = 60.0
    apart: float = 20.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be drawn.

        Raises:
            ConfigError: A figure makes no sense.
        """
        if self.seed < 0:
            raise ConfigError(f"faults.seed: found {self.seed}, expected zero or more")
        _not_negative("faults", {"settle": self.settle, "apart": self.apart})
        for name, fault in self.named():
            figures = {entry.name: getattr(fault, entry.name) for entry in fields(fault)}
            for key in ("sizes", "durations"):
                values = figures.pop(key, (1.0,))
                if not values or not all(0.0 < one < math.inf for one in values):
                    raise ConfigError(
                        f"faults.{name}.{key}: found {values!r}, expected one finite value above "
                        "zero or more"
                    )
            _not_negative(f"faults.{name}", figures)

    def named(self) -> list[tuple[str, Fault]]:
        """Return the kinds that happen, with their names."""
        every = ((name, getattr(self, name)) for name in KINDS)
        return [(name, fault) for name, fault in every if fault is not None]


def _not_negative(where: str, figures: dict[str, float]) -> None:
    for name, value in figures.items():
        if not 0.0 <= value < math.inf:
            raise ConfigError(f"{where}.{name}: found {value}, expected a finite value >= 0")
