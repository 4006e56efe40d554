"""Sweeps: one question over many drives, classes of sensors and lengths of outages.

A sweep is a recipe with a ``sweep`` section in place of ``log``: drives that are simulated, a
real drive with a stated gyro error added, drawn anew per seed, or several real drives.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.document import Recipe, absolute_source, own_content
from navlearn.recipe.experiment_base import Experiment, Titled
from navlearn.recipe.filter_options import checked_filter, checked_ins_filter
from navlearn.recipe.sections import SCENARIO, AidingSection, LogSource
from navlearn.recipe.spec_base import Count, Positive, Seed
from navlearn.recipe.strict import Section, parse
from navlearn.recipe.yaml_file import YamlFile, read_yaml

CLASSES: Final = {"mems_l": "L", "mems_m": "M", "mems_x": "X", "tactical": "T"}
"""Short names of classes of gyros, by grade; other grades go by their own."""

RECORDED: Final = "recorded"
"""Class of drives whose sensors are their own."""


def _each_once(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) != len(values):
        raise ValueError(f"found {list(values)}; list each once")
    return values


def _known_grades(grades: tuple[str, ...]) -> tuple[str, ...]:
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


Grades = Annotated[tuple[str, ...], Field(min_length=1), AfterValidator(_known_grades)]
Durations = Annotated[tuple[Positive, ...], Field(min_length=1), AfterValidator(_each_once)]


class Drives(Section):
    """Drives of a sweep, by grade and seed.

    Attributes:
        grades: Sensor grades, one class of gyros each.
        drives: Drives per grade; for a real drive, draws of the gyro's error.
        first_seed: Seed of the first drive of every grade; the next ones follow.
        durations_s: Lengths of outages; each is placed on every drive.
    """

    grades: Grades
    drives: Count
    first_seed: Seed = 0
    durations_s: Durations = (60.0, 120.0)

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
    """

    type: Literal["simulated"]
    profile: Annotated[str, AfterValidator(_known_profile)] = "mixed"
    duration_s: Positive = 2400.0
    imu_rate_hz: Annotated[float, Field(gt=0, le=1000)] = 10.0
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
    """

    type: Literal["recorded"]
    logs: Annotated[tuple[LogSource, ...], Field(min_length=1)]
    aiding: AidingSection | None = None
    durations_s: Durations = (60.0,)

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


class ManyDrives(Titled):
    """What a sweep is run on.

    Attributes:
        sweep: The drives, and the lengths of outages in place of ``outages.duration_s``.
    """

    sweep: SweptDrives


ByGrade = dict[str, dict[str, Any]]


def _filters_of_grades(filters: ByGrade) -> ByGrade:
    _known_grades(tuple(filters))
    return {grade: checked_filter(options) for grade, options in filters.items()}


def _ins_filters_of_grades(filters: ByGrade) -> ByGrade:
    _known_grades(tuple(filters))
    return {grade: checked_ins_filter(options) for grade, options in filters.items()}


class SweepRecipe(Experiment, ManyDrives):
    """One experiment over many drives, complete.

    Attributes:
        filter_by_grade: Options of the filter by grade, laid over ``filter``: what the data sheet
            of a gyro, or drives that are not scored, tell of its noise. For every method alike.
        ins_filter_by_grade: The same of the full-IMU filter, laid over ``ins_filter``.
    """

    filter_by_grade: Annotated[ByGrade, AfterValidator(_filters_of_grades)] = Field(
        default_factory=dict
    )
    ins_filter_by_grade: Annotated[ByGrade, AfterValidator(_ins_filters_of_grades)] = Field(
        default_factory=dict
    )

    @model_validator(mode="before")
    @classmethod
    def _durations_stand_in_one_place(cls, content: Any) -> Any:
        outages = content.get("outages") if isinstance(content, dict) else None
        if isinstance(outages, dict) and "duration_s" in outages:
            raise ValueError("outages.duration_s: a sweep has sweep.durations_s in its place")
        return content

    @model_validator(mode="after")
    def _observability_is_of_one_drive(self) -> "SweepRecipe":
        if self.observability:
            raise ValueError(
                "observability: a sweep keeps no filter run to tell it of; ask for it in a recipe "
                "of one of its drives"
            )
        return self

    def resolved(self) -> dict[str, Any]:
        """Return the sweep with every default written out, and the versions that made it."""
        content = super().resolved()
        del content["outages"]["duration_s"]
        return content

    @model_validator(mode="after")
    def _filters_are_of_grades_swept(self) -> "SweepRecipe":
        for grade in (*self.filter_by_grade, *self.ins_filter_by_grade):
            if grade not in self.sweep.grades:
                raise ValueError(
                    f"filters by grade: {grade!r} is not among the grades of the sweep: "
                    f"{', '.join(self.sweep.grades)}"
                )
        return self

    def filter_of(self, grade: str | None) -> dict[str, Any]:
        """Return the filter's options for a grade: its own laid over those of all.

        Args:
            grade: Sensor grade; None for what all have in common.
        """
        return _laid_over(self.filter, self.filter_by_grade.get(grade or "", {}))

    def ins_filter_of(self, grade: str | None) -> dict[str, Any]:
        """Return the full-IMU filter's options for a grade, as :meth:`filter_of` does.

        Args:
            grade: Sensor grade; None for what all have in common.
        """
        return _laid_over(self.ins_filter, self.ins_filter_by_grade.get(grade or "", {}))

    def for_drive(self, name: str, duration: float, grade: str | None = None) -> Recipe:
        """Return the recipe of one drive of the sweep.

        Args:
            name: The drive's name; it stands for the log, which nobody opens.
            duration: Length of its outages, s.
            grade: Sensor grade of the drive, for the filter's options; None where no filter runs.
        """
        shared = {key: getattr(self, key) for key in Experiment.model_fields}
        shared["filter"] = self.filter_of(grade)
        shared["ins_filter"] = self.ins_filter_of(grade)
        shared["outages"] = self.outages.model_copy(update={"duration_s": duration})
        return Recipe.model_construct(**shared, log=LogSource(path=Path(name)))

    def shortened(self, *, drives: int | None = None, outages: int | None = None) -> "SweepRecipe":
        """Return the sweep with fewer drives or outages, for a quick look.

        Args:
            drives: Drives per grade; None leaves them.
            outages: Outages per drive and length; None leaves them.

        Raises:
            ConfigError: A number is not positive, or the outages are listed by their times.
        """
        content = self.model_dump()
        del content["outages"]["duration_s"]
        if drives is not None and "logs" in content["sweep"]:
            content["sweep"]["logs"] = content["sweep"]["logs"][:drives]
        elif drives is not None:
            content["sweep"]["drives"] = drives
        if outages is not None:
            content["outages"]["count"] = outages
        return parse(SweepRecipe, content, file=self.name)


def _laid_over(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(common)
    for name, value in own.items():
        both = isinstance(value, dict) and isinstance(merged.get(name), dict)
        merged[name] = {**merged[name], **value} if both else value
    return merged


def load_sweep(path: str | Path) -> SweepRecipe:
    """Read a sweep; paths in it are relative to its own folder.

    Args:
        path: A YAML file with a ``sweep`` section, or a run's resolved one.

    Raises:
        LogNotFoundError: The file or a spec that it names does not exist.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="sweep")
    content = own_content(file)
    section = content.get("sweep")
    if isinstance(section, dict) and isinstance(section.get("log"), dict):
        placed = absolute_source(section["log"], file)
        content["sweep"] = {**section, "log": placed}
    if isinstance(section, dict) and isinstance(section.get("logs"), list):
        logs = [_log_entry(entry, file) for entry in section["logs"]]
        content["sweep"] = {**section, "logs": logs}
    return parse(SweepRecipe, content, file=file)


def _log_entry(entry: Any, file: YamlFile) -> Any:
    """Return a log's entries with absolute paths; a bare text names a descriptor."""
    named = {"descriptor": entry} if isinstance(entry, str) else entry
    return absolute_source(named, file) if isinstance(named, dict) else named


def is_sweep(path: str | Path) -> bool:
    """Return whether a recipe's file has a ``sweep`` section.

    Args:
        path: The file.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: It is no YAML mapping.
    """
    return "sweep" in read_yaml(Path(path), what="recipe").content
