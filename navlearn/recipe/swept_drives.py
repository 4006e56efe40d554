"""The drives of a sweep: simulated, spoilt, drawn from a paper's scenario, or recorded."""

from typing import Annotated, Any, Final, Literal, NamedTuple

from pydantic import AfterValidator, Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.fault_section import FaultSection
from navlearn.recipe.log_section import SCENARIO, AidingSection, LogSource
from navlearn.recipe.satellite_section import Satellites
from navlearn.recipe.sections import Number
from navlearn.recipe.spec_base import Count, Positive, Seed
from navlearn.recipe.strict import Section

CLASSES: Final = {"mems_l": "L", "mems_m": "M", "mems_x": "X", "tactical": "T"}
"""Short names of classes of gyros, by grade; other grades go by their own."""

RECORDED: Final = "recorded"
"""Class of drives whose sensors are their own."""


class Conditions(NamedTuple):
    """What the outages of a part of a sweep have in common.

    Attributes:
        duration: Their length, s.
        satellites: Satellites whose raw ranges stay.
    """

    duration: float
    satellites: int = 0


def _each_once(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) != len(values):
        raise ValueError(f"found {list(values)}; list each once")
    return values


def known_grades(grades: tuple[str, ...]) -> tuple[str, ...]:
    """Return sensor grades, each of which exists and stands once.

    Args:
        grades: Their names.

    Raises:
        ValueError: One is unknown or listed twice.
    """
    from navlearn.logs.synthetic import GRADES

    for grade in grades:
        if grade not in GRADES:
            raise ValueError(
                f"unknown grade {grade!r}{nearest_hint(grade, GRADES)}; known: {', '.join(GRADES)}"
            )
    return _each_once(grades)


def _known_profile(profile: str) -> str:
    from navlearn.logs.synthetic.profile import PROFILES

    if profile not in PROFILES:
        raise ValueError(
            f"unknown profile {profile!r}{nearest_hint(profile, PROFILES)}; "
            f"known: {', '.join(PROFILES)}"
        )
    return profile


Grades = Annotated[tuple[str, ...], Field(min_length=1), AfterValidator(known_grades)]
Durations = Annotated[tuple[Positive, ...], Field(min_length=1), AfterValidator(_each_once)]
Numbers = Annotated[tuple[Number, ...], Field(min_length=1), AfterValidator(_each_once)]


class Drives(Section):
    """Drives of a sweep, by grade and seed.

    Attributes:
        grades: Sensor grades, one class of gyros each.
        drives: Drives per grade; for a real drive, draws of the gyro's error.
        first_seed: Seed of the first drive of every grade; the next ones follow.
        durations_s: Lengths of outages; each is placed on every drive.
        satellites: Numbers of satellites that stay, through the same outages each.
    """

    grades: Grades
    drives: Count
    first_seed: Seed = 0
    durations_s: Durations = (60.0, 120.0)
    satellites: Numbers = (0,)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the drives of each grade."""
        return tuple(range(self.first_seed, self.first_seed + self.drives))


class SimulatedDrives(Drives):
    """Drives that the simulator makes, road and sensors from the seed.

    Attributes:
        type: Kind of drives.
        profile: Kind of road.
        duration_s: Length of each drive.
        imu_rate_hz: Rate of the inertial samples.
        sky: Satellites, streets and receiver that the logs have raw ranges from: a preset such as
            ``suburban``, or options over one; None for logs without ranges.
        faults: What goes wrong with the fixes of every drive, drawn anew per seed; None leaves
            them as they are.
    """

    type: Literal["simulated"]
    profile: Annotated[str, AfterValidator(_known_profile)] = "mixed"
    duration_s: Positive = 2400.0
    imu_rate_hz: Annotated[float, Field(gt=0, le=1000)] = 10.0
    sky: Satellites | None = None
    faults: FaultSection | None = None
    drives: Count = 20


class DegradedDrives(Drives):
    """A real drive with the gyro error of a grade added, drawn anew per seed.

    Attributes:
        type: Kind of drives.
        log: The real drive; its gyro is clearly better than the grades.
    """

    type: Literal["degraded"]
    log: LogSource
    drives: Count = 1
    durations_s: Durations = (60.0,)

    @model_validator(mode="after")
    def _spoilt_once(self) -> "DegradedDrives":
        if self.log.gyro is not None:
            raise ValueError("log.gyro: the sweep's grades tell the gyro's error; leave it out")
        return self


class ScenarioDrives(Section):
    """A paper's simulated scenario, its noise drawn anew per seed.

    Attributes:
        type: Kind of drives.
        scenario: Which one: that of [Jaradat2017] §IV.
        drives: How many draws.
        first_seed: Seed of the first; the next ones follow.
        durations_s: Lengths of outages; each is placed on every drive.
    """

    type: Literal["scenario"]
    scenario: Literal["jaradat2017"] = SCENARIO
    drives: Count = 20
    first_seed: Seed = 0
    durations_s: Durations = (5.0,)

    @property
    def satellites(self) -> tuple[int, ...]:
        """The scenario knows no satellites."""
        return (0,)

    @property
    def grades(self) -> tuple[str, ...]:
        """The one class of all drives."""
        return (self.scenario,)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the drives."""
        return tuple(range(self.first_seed, self.first_seed + self.drives))


class RecordedDrives(Section):
    """Several real drives as they were recorded, one class together.

    Attributes:
        type: Kind of drives.
        logs: The drives.
        aiding: Fixes and odometer to make from the reference of every drive that tells none of
            its own; the seed grows by one from drive to drive.
        durations_s: Lengths of outages; each is placed on every drive into which one fits.
        satellites: Numbers of satellites that stay, through the same outages each.
    """

    type: Literal["recorded"]
    logs: Annotated[tuple[LogSource, ...], Field(min_length=1)]
    aiding: AidingSection | None = None
    durations_s: Durations = (60.0,)
    satellites: Numbers = (0,)

    @property
    def grades(self) -> tuple[str, ...]:
        """The one class of all drives."""
        return (RECORDED,)

    @property
    def drives(self) -> int:
        """Number of drives."""
        return len(self.logs)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Numbers of the drives, by which rows are kept apart."""
        return tuple(range(len(self.logs)))

    def source(self, number: int) -> LogSource:
        """Return where a drive is, with its aiding.

        Args:
            number: Which drive.
        """
        source = self.logs[number]
        if source.aiding is not None or self.aiding is None:
            return source
        aiding = self.aiding.model_copy(update={"seed": self.aiding.seed + number})
        return source.model_copy(update={"aiding": aiding})


SweptDrives = Annotated[
    SimulatedDrives | DegradedDrives | ScenarioDrives | RecordedDrives,
    Field(discriminator="type"),
]
