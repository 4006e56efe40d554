"""The sections of a recipe, one class each."""

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.outages.published import PublishedTable
from navlearn.outages.schedule import OutageProtocol
from navlearn.recipe.spec_base import Count, NotNegative, Positive, Seed
from navlearn.recipe.strict import Section

SCENARIO: Final = "jaradat2017"
"""Profile that is a paper's simulated scenario."""

Dynamics = Literal["straight", "turn", "stop", "motorway", "hill"]

_PLACED = OutageProtocol()


class GyroErrorSection(Section):
    """A stated synthetic error that is added to a good gyro: semi-synthetic data.

    Attributes:
        grade: Sensor grade whose gyro error is added, such as ``mems_l``.
        seed: Seed of its draws.
    """

    grade: str
    seed: Seed = 0


class AidingSection(Section):
    """Fixes and odometer made from the log's reference: semi-real data.

    Attributes:
        grade: Sensor grade whose GNSS and odometer figures are taken, such as ``mems_m``.
        fix_rate_hz: Rate of the fixes.
        fix_noise: White noise of their position, m, in place of the grade's errors of position.
        odometer: Whether an odometer is made.
        odometer_rate_hz: Its rate.
        seed: Seed of the draws.
    """

    grade: str = "mems_m"
    fix_rate_hz: Positive = 1.0
    fix_noise: Positive | None = None
    odometer: bool = True
    odometer_rate_hz: Positive = 10.0
    seed: Seed = 0


class SimulatedSection(Section):
    """A drive that the simulator makes when the recipe is run.

    Attributes:
        profile: Kind of road; or ``jaradat2017``, the scenario of that paper's section IV, which
            has its own sensors, length and rates.
        grade: Sensor grade.
        duration_s: Length of the drive.
        imu_rate_hz: Rate of the inertial samples.
        seed: Seed of road and sensors.
    """

    profile: str = "mixed"
    grade: str = "mems_m"
    duration_s: Positive = 1800.0
    imu_rate_hz: Annotated[float, Field(gt=0, le=1000)] = 100.0
    seed: Seed = 0

    @model_validator(mode="after")
    def _profile_exists(self) -> "SimulatedSection":
        from navlearn.logs.synthetic.profile import PROFILES

        known = (*PROFILES, SCENARIO)
        if self.profile not in known:
            raise ValueError(
                f"unknown profile {self.profile!r}{nearest_hint(self.profile, known)}; "
                f"known: {', '.join(known)}"
            )
        if self.profile == SCENARIO:
            self._nothing_but_the_seed()
        return self

    def _nothing_but_the_seed(self) -> None:
        for name in ("grade", "duration_s", "imu_rate_hz"):
            found = getattr(self, name)
            if found != type(self).model_fields[name].default:
                raise ValueError(
                    f"{name} is {found!r}, but profile {SCENARIO!r} has its own sensors, length "
                    "and rates; leave it out"
                )


class LogSource(Section):
    """Where the drive is: a descriptor of ``datasets/``, a path and its format, or a simulation.

    Attributes:
        descriptor: YAML descriptor of a published log.
        path: Log file or folder, for logs that need no descriptor.
        format: Reader of ``path`` (docs/logs.md lists them), or a descriptor whose layout is
            applied; recognised where left out.
        simulated: A drive to simulate.
        between_s: First and last time of the part that is used, on the log's clock; null for all.
        gyro: A synthetic error to add to the log's gyro; None leaves it as it was recorded.
        aiding: Fixes and odometer to make from the reference, for logs that have none of their
            own; None takes what the log has.
    """

    descriptor: Path | None = None
    path: Path | None = None
    format: str | None = None
    simulated: SimulatedSection | None = None
    between_s: tuple[float, float] | None = None
    gyro: GyroErrorSection | None = None
    aiding: AidingSection | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "LogSource":
        given = [self.descriptor, self.path, self.simulated]
        if sum(one is not None for one in given) != 1:
            raise ValueError(
                "give one of 'descriptor', 'path' (with 'format') and 'simulated', not several "
                "or none"
            )
        if self.between_s is not None and not self.between_s[0] < self.between_s[1]:
            raise ValueError(f"between_s is {list(self.between_s)}; give first and last time, s")
        if self.format is not None and self.path is None:
            raise ValueError("'format' belongs to 'path'; a descriptor names its own format")
        return self


class MechanizationSection(Section):
    """How the car is dead-reckoned.

    Attributes:
        dims: 2 for the horizontal plane, 3 with tilt from the accelerometers and the odometer.
        rate_hz: Rate at which the mechanization of one gyro and odometer steps.
        sensors: Of what ``dead_reckoning`` and ``rts`` are made: ``riss``, one gyro and the
            odometer; or ``imu``, the full IMU.
        imu_rate_hz: Rate at which the strapdown mechanization steps; null for the log's own.
        imu_max_gap_s: Longest gap in the full IMU that may be bridged.
    """

    dims: Literal[2, 3] = 2
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 10.0
    sensors: Literal["riss", "imu"] = "riss"
    imu_rate_hz: Annotated[float, Field(gt=0, le=10000)] | None = None
    imu_max_gap_s: Positive = 0.5


class OutageSection(Section):
    """Where GNSS is taken away; the fields of :class:`navlearn.outages.schedule.OutageProtocol`.

    Attributes:
        placement: ``spread`` evenly, ``listed`` times, ``random``, or ``by_dynamics``.
        count: How many outages; for ``listed`` the number of ``times_s``.
        fewer: Whether a drive into which fewer fit (one at least) has fewer.
        duration_s: Length of each outage.
        warm_up_s: Time from the log's start before which no outage starts.
        warm_up_moving_s: Time the car must have moved before the first outage.
        min_gap_s: Shortest time from the end of one outage to the start of the next.
        seed: Seed of the draw, for ``random``.
        times_s: Starts of the outages, for ``listed`` only.
        classes: Dynamics that ``by_dynamics`` looks for.
        min_mean_speed: Lowest mean speed through an outage, m/s.
        max_fix_interval_s: Good GNSS has fixes at most this far apart.
        good_before_s: How long GNSS must have been good before an outage.
        max_reference_interval_s: A longer hole in the reference makes it bad.
        max_reference_slip: Disagreement of the reference with its own velocity that makes it
            bad, m.
        slip_span_s: Time over which that disagreement is taken.
    """

    placement: Literal["spread", "listed", "random", "by_dynamics"] = "spread"
    count: Count = _PLACED.count
    fewer: bool = _PLACED.fewer
    duration_s: Positive = _PLACED.duration
    warm_up_s: NotNegative = _PLACED.warm_up
    warm_up_moving_s: NotNegative = _PLACED.warm_up_moving
    min_gap_s: NotNegative = _PLACED.min_gap
    seed: Seed = _PLACED.seed
    times_s: tuple[NotNegative, ...] | None = None
    classes: tuple[Dynamics, ...] = ("straight", "turn", "stop", "motorway", "hill")
    min_mean_speed: NotNegative = _PLACED.min_mean_speed
    max_fix_interval_s: Positive = _PLACED.max_fix_interval
    good_before_s: NotNegative = _PLACED.good_before
    max_reference_interval_s: Positive = _PLACED.max_reference_interval
    max_reference_slip: NotNegative = _PLACED.max_reference_slip
    slip_span_s: Positive = _PLACED.slip_span

    @model_validator(mode="before")
    @classmethod
    def _count_listed(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        times = content.get("times_s")
        if content.get("placement") == "listed" and isinstance(times, list | tuple):
            return {"count": len(times), **content}
        return content

    @model_validator(mode="after")
    def _times_belong_to_listed(self) -> "OutageSection":
        if (self.placement == "listed") != bool(self.times_s):
            raise ValueError(
                "'times_s' lists the starts for placement 'listed', and only for it; "
                f"found placement {self.placement!r} with times_s {self.times_s}"
            )
        if self.times_s is not None and self.count != len(self.times_s):
            raise ValueError(
                f"count is {self.count} but times_s lists {len(self.times_s)}; drop count"
            )
        if not self.classes or len(set(self.classes)) != len(self.classes):
            raise ValueError(f"classes are {list(self.classes)}; give some, each once")
        return self

    def protocol(self) -> OutageProtocol:
        """Return the section as the outage protocol that places outages."""
        values = {name.removesuffix("_s"): value for name, value in self.model_dump().items()}
        return OutageProtocol(**{**values, "times": self.times_s or ()})


class PublishedSection(Section):
    """A table of a paper; the fields of :class:`navlearn.outages.published.PublishedTable`.

    Attributes:
        source: The paper's key in ``docs/references.bib``.
        caption: What the table shows.
        columns: Names of the columns, with units.
        rows: Cells of every line, as many as there are columns.
        remark: How far it may be compared with ours.
    """

    source: str
    caption: str
    columns: Annotated[tuple[str, ...], Field(min_length=1)]
    rows: tuple[tuple[str | float, ...], ...]
    remark: str = ""

    @model_validator(mode="after")
    def _cells_fit(self) -> "PublishedSection":
        self.table()
        return self

    def table(self) -> PublishedTable:
        """Return the section as the table that a report prints."""
        return PublishedTable(**self.model_dump())


class TrainingSection(Section):
    """What an error model learns from, for every outage anew.

    Attributes:
        regime: ``online``: this drive, before the outage.
        horizon_s: Length of the emulated outages it learns from.
        restart_every_s: Time between the starts of emulated outages.
        step_s: Sampling interval of regressors and targets.
        window_s: How far back before the outage training reaches; null for all of it.
        gap_s: Time left unused between training and validation data.
        minimum_distance: Emulated outages in which the car drives less are left out, m.
        settle_s: Time after the filter's alignment in which no emulated outage starts.
    """

    regime: Literal["online"] = "online"
    horizon_s: Positive = 60.0
    restart_every_s: Positive = 10.0
    step_s: Positive = 1.0
    window_s: Positive | None = None
    gap_s: NotNegative = 10.0
    minimum_distance: NotNegative = 60.0
    settle_s: NotNegative = 60.0

    @model_validator(mode="after")
    def _lengths_fit(self) -> "TrainingSection":
        if self.horizon_s < self.step_s:
            raise ValueError(
                f"horizon_s {self.horizon_s} is shorter than one step_s {self.step_s}; "
                "an emulated outage needs at least one step"
            )
        if self.window_s is not None and self.window_s < self.horizon_s:
            raise ValueError(
                f"window_s {self.window_s} is shorter than horizon_s {self.horizon_s}; "
                "a window must hold at least one emulated outage"
            )
        return self


def _latency(value: Any) -> Any:
    if value == "estimate":
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 10.0:
        raise ValueError(f"expected 'estimate' or seconds from -10 to 10, found {value!r}")
    return float(value)


Latency = Annotated[Literal["estimate"] | float, BeforeValidator(_latency)]


class CalibrationSection(Section):
    """How late streams are stamped against the IMU.

    Attributes:
        odometer_latency: Seconds, or ``estimate`` from the drive before the first outage.
        gnss_latency: Seconds, or ``estimate`` likewise.
    """

    odometer_latency: Latency = "estimate"
    gnss_latency: Latency = "estimate"
