"""Sweeps: one question over many drives, classes of sensors, lengths of outages and satellites.

A sweep is a recipe with a ``sweep`` section in place of ``log``: drives that are simulated, a
real drive with a stated gyro error added, drawn anew per seed, or several real drives.
"""

from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import AfterValidator, Field, model_validator

from navlearn.recipe.document import Recipe, absolute_source, own_content
from navlearn.recipe.experiment_base import Experiment, Titled
from navlearn.recipe.filter_options import checked_filter, checked_ins_filter
from navlearn.recipe.log_section import LogSource
from navlearn.recipe.overrides import laid_over
from navlearn.recipe.strict import parse
from navlearn.recipe.swept_drives import Conditions, SweptDrives, known_grades
from navlearn.recipe.tuned_spec import TunedSpec
from navlearn.recipe.yaml_file import YamlFile, read_yaml

IN_SWEEP: Final = {"duration_s": "durations_s", "satellites": "satellites"}
"""Keys of ``outages`` in whose place a sweep has keys of its own."""


class ManyDrives(Titled):
    """What a sweep is run on.

    Attributes:
        sweep: The drives, the lengths of outages in place of ``outages.duration_s``, and the
            numbers of satellites in place of ``outages.satellites``.
    """

    sweep: SweptDrives


ByGrade = dict[str, dict[str, Any]]


def _filters_of_grades(filters: ByGrade) -> ByGrade:
    known_grades(tuple(filters))
    return {grade: checked_filter(options) for grade, options in filters.items()}


def _ins_filters_of_grades(filters: ByGrade) -> ByGrade:
    known_grades(tuple(filters))
    return {grade: checked_ins_filter(options) for grade, options in filters.items()}


def _tunings_of_grades(tunings: dict[str, TunedSpec]) -> dict[str, TunedSpec]:
    known_grades(tuple(tunings))
    return tunings


class SweepRecipe(Experiment, ManyDrives):
    """One experiment over many drives, complete.

    Attributes:
        filter_by_grade: Options of the filter by grade, laid over ``filter``: what the data sheet
            of a gyro, or drives that are not scored, tell of its noise. For every method alike.
        ins_filter_by_grade: The same of the full-IMU filter, laid over ``ins_filter``.
        tuned_by_grade: What was tuned for the drives of a grade, in place of ``tuned``.
    """

    filter_by_grade: Annotated[ByGrade, AfterValidator(_filters_of_grades)] = Field(
        default_factory=dict
    )
    ins_filter_by_grade: Annotated[ByGrade, AfterValidator(_ins_filters_of_grades)] = Field(
        default_factory=dict
    )

    tuned_by_grade: Annotated[dict[str, TunedSpec], AfterValidator(_tunings_of_grades)] = Field(
        default_factory=dict
    )

    @model_validator(mode="before")
    @classmethod
    def _durations_and_satellites_stand_in_one_place(cls, content: Any) -> Any:
        outages = content.get("outages") if isinstance(content, dict) else None
        for key, place in IN_SWEEP.items():
            if isinstance(outages, dict) and key in outages:
                raise ValueError(f"outages.{key}: a sweep has sweep.{place} in its place")
        return content

    @model_validator(mode="after")
    def _as_many_are_listed(self) -> "SweepRecipe":
        listed, most = self.outages.visible_satellites, max(self.sweep.satellites)
        if listed is not None and most > len(listed):
            raise ValueError(
                f"sweep.satellites: {most} are to stay but outages.visible_satellites lists "
                f"{len(listed)}; list more, or ask for fewer"
            )
        return self

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
        for key in IN_SWEEP:
            del content["outages"][key]
        return content

    @model_validator(mode="after")
    def _filters_are_of_grades_swept(self) -> "SweepRecipe":
        for grade in (*self.filter_by_grade, *self.ins_filter_by_grade, *self.tuned_by_grade):
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
        return laid_over(self.filter, self.filter_by_grade.get(grade or "", {}))

    def ins_filter_of(self, grade: str | None) -> dict[str, Any]:
        """Return the full-IMU filter's options for a grade, as :meth:`filter_of` does.

        Args:
            grade: Sensor grade; None for what all have in common.
        """
        return laid_over(self.ins_filter, self.ins_filter_by_grade.get(grade or "", {}))

    def tuned_of(self, grade: str | None) -> TunedSpec | None:
        """Return what was tuned for a grade, or else for all.

        Args:
            grade: Sensor grade; None for what all have in common.
        """
        return self.tuned_by_grade.get(grade or "", self.tuned)

    @property
    def tunings(self) -> tuple[TunedSpec | None, ...]:
        """What is tuned: one for each grade, None where nothing is."""
        return tuple(self.tuned_of(grade) for grade in self.sweep.grades)

    @property
    def conditions(self) -> tuple[Conditions, ...]:
        """Lengths of outages and numbers of satellites, one length after another."""
        return tuple(
            Conditions(duration, satellites)
            for duration in self.sweep.durations_s
            for satellites in self.sweep.satellites
        )

    def for_drive(
        self, name: str, duration: float, grade: str | None = None, satellites: int = 0
    ) -> Recipe:
        """Return the recipe of one drive of the sweep.

        Args:
            name: The drive's name; it stands for the log, which nobody opens.
            duration: Length of its outages, s.
            grade: Sensor grade of the drive, for the filter's options; None where no filter runs.
            satellites: How many stay; the outages are those through which as many could stay as
                the sweep asks for at most.
        """
        shared = {key: getattr(self, key) for key in Experiment.model_fields}
        shared["filter"] = self.filter_of(grade)
        shared["ins_filter"] = self.ins_filter_of(grade)
        shared["tuned"] = self.tuned_of(grade)
        most = max(self.outages.min_satellites, *self.sweep.satellites)
        own = {"duration_s": duration, "satellites": satellites, "min_satellites": most}
        shared["outages"] = self.outages.model_copy(update=own)
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
        for key in IN_SWEEP:
            del content["outages"][key]
        if drives is not None and "logs" in content["sweep"]:
            content["sweep"]["logs"] = content["sweep"]["logs"][:drives]
        elif drives is not None:
            content["sweep"]["drives"] = drives
        if outages is not None:
            content["outages"]["count"] = outages
        return parse(SweepRecipe, content, file=self.name)


def load_sweep(path: str | Path, *, untuned: bool = False) -> SweepRecipe:
    """Read a sweep; paths in it are relative to its own folder.

    Args:
        path: A YAML file with a ``sweep`` section, or a run's resolved one.
        untuned: Leave out what it says of tuning, as :func:`navlearn.recipe.load_recipe` does.

    Raises:
        LogNotFoundError: The file or a spec that it names does not exist.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="sweep")
    content = own_content(file, untuned=untuned)
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
