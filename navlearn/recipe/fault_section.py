"""The faults that a recipe puts into the fixes of its log."""

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, model_validator

from navlearn.recipe.spec_base import NotNegative, Positive, Seed
from navlearn.recipe.strict import Section

if TYPE_CHECKING:
    from navlearn.logs.synthetic.fault_options import FaultOptions

Values = Annotated[tuple[Positive, ...], Field(min_length=1)]


class SpikeSection(Section):
    """Single fixes that are off in a random horizontal direction.

    Attributes:
        sizes_m: Horizontal sizes; each fault draws one.
        per_hour: How many begin per hour, on average.
        vertical: Offset up or down over the horizontal one.
        velocity: By how much the velocity is off, too, m/s.
        honest: Whether the receiver's stated deviations grow by the offset.
    """

    sizes_m: Values = (20.0,)
    per_hour: NotNegative = 30.0
    vertical: NotNegative = 0.0
    velocity: NotNegative = 0.0
    honest: bool = False


class BiasSection(SpikeSection):
    """Stretches whose fixes are all off by the same.

    Attributes:
        durations_s: Lengths; each fault draws one.
    """

    per_hour: NotNegative = 6.0
    durations_s: Values = (30.0,)


class RampSection(Section):
    """Stretches through which an offset grows steadily, as a spoofer's does.

    Attributes:
        sizes_m: Horizontal sizes at the end; each fault draws one.
        durations_s: Times of growth; each fault draws one.
        per_hour: How many begin per hour, on average.
        vertical: Offset up or down over the horizontal one.
        velocity: Whether the velocity is off by the rate of growth.
        honest: Whether the receiver's stated deviations grow by the offset.
    """

    sizes_m: Values = (50.0,)
    durations_s: Values = (60.0,)
    per_hour: NotNegative = 4.0
    vertical: NotNegative = 0.0
    velocity: bool = False
    honest: bool = False


class FreezeSection(Section):
    """Stretches through which the receiver repeats its last position.

    Attributes:
        durations_s: Lengths; each fault draws one.
        per_hour: How many begin per hour, on average.
        velocity: Whether the velocity is repeated, too.
    """

    durations_s: Values = (20.0,)
    per_hour: NotNegative = 4.0
    velocity: bool = False


class FaultSection(Section):
    """Faults put into the fixes of any log; a kind that is not named does not happen.

    Attributes:
        spikes: Single fixes that are off.
        biases: Stretches that are off by a step.
        ramps: Stretches that are led away.
        freezes: Stretches through which a position is repeated.
        settle_s: So long after the first fix nothing goes wrong.
        apart_s: So long after the end of a fault no other begins.
        seed: Seed of every draw.
    """

    spikes: SpikeSection | None = None
    biases: BiasSection | None = None
    ramps: RampSection | None = None
    freezes: FreezeSection | None = None
    settle_s: NotNegative = 60.0
    apart_s: NotNegative = 20.0
    seed: Seed = 0

    @model_validator(mode="after")
    def _something_fails(self) -> "FaultSection":
        from navlearn.logs.synthetic.fault_options import KINDS

        if all(getattr(self, name) is None for name in KINDS):
            raise ValueError(f"names no kind of fault; name some of {', '.join(KINDS)}")
        return self

    def options(self, more_seed: int = 0) -> "FaultOptions":
        """Return the faults as the log's own room takes them.

        Args:
            more_seed: Added to the seed, such as the number of a swept drive.
        """
        from navlearn.logs.synthetic.fault_options import KINDS, FaultOptions

        kinds: dict[str, Any] = {
            name: kind(**_without_units(getattr(self, name).model_dump()))
            for name, kind in KINDS.items()
            if getattr(self, name) is not None
        }
        return FaultOptions(
            **kinds, settle=self.settle_s, apart=self.apart_s, seed=self.seed + more_seed
        )


def _without_units(values: dict[str, Any]) -> dict[str, Any]:
    plain = {"sizes_m": "sizes", "durations_s": "durations"}
    return {plain.get(name, name): value for name, value in values.items()}
