"""What a descriptor says about plain tables: columns, units, origin of local positions."""

import re
from typing import Annotated, Final, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

Finite = Annotated[float, Field(allow_inf_nan=False)]
Latency = Annotated[float, Field(ge=-10.0, le=10.0)]

RINEX_ENDING: Final = re.compile(r"\.(\d\d[od]|obs|rnx|crx)(\.(gz|bz2|zip|z))?$", re.IGNORECASE)
"""How names of RINEX observation files end."""


class Strict(BaseModel):
    """A part of a descriptor: unchangeable, and an unknown key is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Column(Strict):
    """Where a canonical column comes from: ``scale`` × value in its unit + ``offset``.

    Attributes:
        column: Name in the file.
        unit: Its unit, such as ``deg`` or ``km/h``; SI and radians where left out.
        scale: Factor beside the unit's, such as −1 for a sign of the other sense.
        offset: Added after scaling, in SI and radians.
    """

    column: str
    unit: str | None = None
    scale: Finite = 1.0
    offset: Finite = 0.0

    @model_validator(mode="before")
    @classmethod
    def _from_bare_name(cls, found: object) -> object:
        return {"column": found} if isinstance(found, str) else found


class SpeedAndCourse(Strict):
    """Horizontal velocity given as its size and direction.

    Attributes:
        speed: Ground speed.
        course: Direction, clockwise from north.
    """

    speed: Column
    course: Column


class SatelliteName(Strict):
    """A satellite given by two columns: its constellation's RINEX letter and its number.

    Attributes:
        constellation: Column of the letters.
        number: Column of the numbers.
    """

    constellation: str
    number: str


class Table(Strict):
    """One table of a plain-table log.

    Attributes:
        file: File name in the log's folder.
        format: ``table`` (CSV or Parquet); or what a receiver wrote: ``nmea`` or ``ubx`` for
            fixes, ``rinex`` for ranges. Left out, the file's ending tells.
        time: Column of time stamps.
        columns: Canonical column to where it comes from; a bare string is a name in SI units.
            Left out, the file's own canonical names are taken, unit suffixes understood. Where
            the descriptor states an ``origin``, also ``east``, ``north`` and ``up``.
        velocity: Horizontal velocity, where the file has it as speed and course.
        satellite: Satellites of ``ranges``, where the file has constellation and number apart.
        epoch: Column of exact epochs on the receiver's own clock, where ``time`` is the jittery
            time of arrival.
        clock_start: What UTC it was when the clock of the log's other tables read zero, for a
            receiver's file; left out where they are stamped in UTC seconds since 1970.
        navigation: For ranges in ``rinex``: the file of broadcast orbits, or one per
            constellation.
        codes: For ranges in ``rinex``: the codes to read by constellation, such as
            ``{E: [C1X]}``, the first that the file has; usual ones where left out.
        sampling: ``interval`` where a sample is the mean over the interval ending at its time.
    """

    file: str
    format: Literal["table", "nmea", "ubx", "rinex"] | None = None
    time: Column = Column(column="t")
    columns: dict[str, Column] | None = None
    velocity: SpeedAndCourse | None = None
    satellite: SatelliteName | None = None
    epoch: Column | None = None
    clock_start: AwareDatetime | None = None
    navigation: str | tuple[str, ...] | None = None
    codes: dict[Literal["G", "R", "E", "C", "J"], tuple[str, ...]] | None = None
    sampling: Literal["instant", "interval"] = "instant"

    @property
    def kind(self) -> str:
        """What the file is: ``table``, ``nmea``, ``ubx`` or ``rinex``."""
        if self.format is not None:
            return self.format
        if RINEX_ENDING.search(self.file):
            return "rinex"
        ending = self.file.lower().removesuffix(".gz").rpartition(".")[2]
        return ending if ending in ("nmea", "ubx") else "table"


class Origin(Strict):
    """Where a log's local positions in metres begin.

    Attributes:
        lat_deg: Geodetic latitude.
        lon_deg: Longitude.
        height: Height above the ellipsoid, m.
        plane: ``tangent``, or ``mercator`` where latitude and longitude went through a
            spherical Mercator map, scaled to be true to the sphere at the origin (KITTI).
    """

    lat_deg: Annotated[float, Field(ge=-89.0, le=89.0)]
    lon_deg: Annotated[float, Field(ge=-180.0, le=360.0)]
    height: Finite = 0.0
    plane: Literal["tangent", "mercator"] = "tangent"


class ReferenceLatency(Strict):
    """How late a reference is stamped against the IMU, s.

    Attributes:
        pose: Its positions and angles.
        velocity: Its velocities.
    """

    pose: Latency = 0.0
    velocity: Latency = 0.0
