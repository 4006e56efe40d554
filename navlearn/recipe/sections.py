"""The sections of a recipe, one class each."""

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from navlearn.logs.range_checks import CONSTELLATIONS
from navlearn.outages.published import PublishedTable
from navlearn.outages.schedule import OutageProtocol
from navlearn.recipe.spec_base import Count, NotNegative, Positive, Seed
from navlearn.recipe.strict import Section

Dynamics = Literal["straight", "turn", "stop", "motorway", "hill"]
Visible = Literal["highest", "best_geometry", "worst_geometry", "random", "listed"]
Number = Annotated[int, Field(ge=0, le=100)]
SatelliteName = Annotated[str, Field(pattern=f"^[{CONSTELLATIONS}][0-9]{{1,3}}$")]

_PLACED = OutageProtocol()


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
        satellites: Satellites whose raw ranges stay through an outage; for ``listed`` the number
            of ``visible_satellites`` where left out.
        visible: By which rule they are chosen: ``highest``, ``best_geometry``,
            ``worst_geometry``, ``random`` (with ``seed``) or ``listed``.
        visible_satellites: Names such as ``G07``, for ``listed`` only; the first ones stay.
        min_tracked: Share of the receptions through the outage that a satellite must be among.
        min_elevation_deg: Lowest elevation of a satellite that may stay.
        min_satellites: An outage through which fewer could stay is not scored.
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
    satellites: Number = _PLACED.satellites
    visible: Visible = "highest"
    visible_satellites: tuple[SatelliteName, ...] | None = None
    min_tracked: Annotated[float, Field(gt=0, le=1)] = _PLACED.min_tracked
    min_elevation_deg: Annotated[float, Field(ge=0, lt=90)] = round(
        math.degrees(_PLACED.min_elevation), 9
    )
    min_satellites: Number = _PLACED.min_satellites

    @model_validator(mode="before")
    @classmethod
    def _count_listed(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        times, names = content.get("times_s"), content.get("visible_satellites")
        if content.get("placement") == "listed" and isinstance(times, list | tuple):
            content = {"count": len(times), **content}
        if content.get("visible") == "listed" and isinstance(names, list | tuple):
            content = {"satellites": len(names), **content}
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

    @model_validator(mode="after")
    def _satellites_belong_together(self) -> "OutageSection":
        names = self.visible_satellites or ()
        if (self.visible == "listed") != bool(names) or len(set(names)) < len(names):
            raise ValueError(
                "'visible_satellites' lists the satellites for visible 'listed', each once, and "
                f"only for it; found visible {self.visible!r} with visible_satellites {list(names)}"
            )
        needed = max(self.satellites, self.min_satellites)
        if names and needed > len(names):
            raise ValueError(
                f"{needed} satellites are to stay but visible_satellites lists {len(names)}; "
                "list more, or ask for fewer"
            )
        return self

    def protocol(self) -> OutageProtocol:
        """Return the section as the outage protocol that places outages."""
        values = {name.removesuffix("_s"): value for name, value in self.model_dump().items()}
        elevation = math.radians(values.pop("min_elevation_deg"))
        lists = {
            "times": self.times_s or (),
            "visible_satellites": self.visible_satellites or (),
            "min_elevation": elevation,
        }
        return OutageProtocol(**{**values, **lists})


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
