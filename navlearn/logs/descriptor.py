"""Descriptors: what a YAML file says about a published drive log.

A descriptor names the format and the folder, and for plain tables the columns, their units and
axes; and for every format what the files themselves cannot tell: lever arm, latencies, height
datum, mounting. An unknown key is refused with the nearest known one.
"""

import math
import os
import re
from pathlib import Path
from typing import Annotated, Final, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, Field, ValidationError, model_validator

from navlearn.errors import ConfigError, LogNotFoundError
from navlearn.logs.axes import levelling_matrix, matrix_from_directions, matrix_from_letters
from navlearn.logs.interval_means import FloatArray
from navlearn.logs.nearest import nearest_hint
from navlearn.logs.table_layout import (
    Column,
    Finite,
    Latency,
    Origin,
    ReferenceLatency,
    SatelliteName,
    SpeedAndCourse,
    Strict,
    Table,
)

FORMAT_ALIASES: Final = {"navlearn": "native"}
"""Other names of formats: navlearn's own is also called by its name."""

FormatName = Annotated[
    Literal[
        "navinst", "canedge", "kitti", "comma2k19", "sensorlogger", "smartloc", "csv", "native"
    ],
    BeforeValidator(lambda name: FORMAT_ALIASES.get(name, name) if isinstance(name, str) else name),
]
TableName = Literal["imu", "odometer", "fixes", "reference", "ranges"]
Correction = Literal["satellite_clock", "ionosphere", "troposphere", "earth_rotation"]
GpsSeconds = Annotated[float, Field(ge=0.0, le=1e10, allow_inf_nan=False)]
Backstep = Literal["error", "drop"]
Seconds = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class Directions(Strict):
    """Which sensor axis points right, forward and up, such as ``-y``.

    Attributes:
        right: Sensor axis that points right.
        forward: Sensor axis that points forward.
        up: Sensor axis that points up.
    """

    right: str
    forward: str
    up: str


class Mounting(Strict):
    """How the sensor is turned in the car, after its axes are named.

    Attributes:
        pitch_deg: Pitch of the sensor, nose up.
        roll_deg: Roll of the sensor, right side down.
        yaw_deg: How far its forward axis lies clockwise of the car's, seen from above.
    """

    pitch_deg: float = Field(default=0.0, ge=-60.0, le=60.0)
    roll_deg: float = Field(default=0.0, ge=-60.0, le=60.0)
    yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)


class Descriptor(Strict):
    """What is known about a drive log beside its files.

    Attributes:
        name: Short name of the log.
        format: Published format.
        path: Folder or file, relative to the descriptor; ``${NAVLEARN_DATA}`` is the
            environment variable of that name, relative to the working directory, or
            ``../../shared/data`` where it is not set.
        license: Licence of the data.
        time_scale: Name of the log's own clock.
        tables: Tables of a ``csv`` log.
        origin: Where positions in local metres (east, north, up) of a ``csv`` log begin.
        axes: Sensor axes, as three letters (``FLU``) or by direction; the format's own where
            left out.
        mounting: How the sensor is turned in the car after that.
        geoid_height: Height of the geoid above the ellipsoid, m, added to the fixes' heights;
            the format's own where left out.
        lever_arm: Antenna from the IMU, right, forward, up, m.
        gnss_latency: How late fixes are stamped, s; removed on loading.
        odometer_latency: How late odometer samples are stamped, s; removed on loading.
        reference_latency: How late the reference is stamped, s; removed on loading.
        range_corrections: What has already been done to the ranges, of
            :data:`navlearn.logs.columns.RANGE_CORRECTIONS`; the format's own where left out.
        klobuchar: Ionosphere as GPS broadcasts it, α₀ to α₃ and β₀ to β₃; the format's own where
            left out.
        gps_time_origin: What zero of the log's own clock was, GPS seconds since 6 January 1980
            (604800 times the week where it counts seconds of week); the format's own where left
            out.
        section_s: Part of the drive that is used: from and up to how many seconds after its
            first sample; null for its begin or end.
        on_backstep: ``error``, or ``drop`` rows that do not come later than all before them.
        sensors: Free text per sensor.
    """

    name: str = Field(min_length=1)
    format: FormatName
    path: str
    license: str = ""
    time_scale: str = ""
    tables: dict[TableName, Table] | None = None
    origin: Origin | None = None
    axes: str | Directions | None = None
    mounting: Mounting = Mounting()
    geoid_height: Finite | None = None
    lever_arm: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    gnss_latency: Latency = 0.0
    odometer_latency: Latency = 0.0
    reference_latency: ReferenceLatency = ReferenceLatency()
    range_corrections: tuple[Correction, ...] | None = None
    klobuchar: Annotated[tuple[Finite, ...], Field(min_length=8, max_length=8)] | None = None
    gps_time_origin: GpsSeconds | None = None
    section_s: tuple[Seconds | None, Seconds | None] = (None, None)
    on_backstep: Backstep = "error"
    sensors: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _axes_are_a_triad(self) -> "Descriptor":
        self.body_from_sensor("RFU")
        return self

    @model_validator(mode="after")
    def _section_has_a_length(self) -> "Descriptor":
        start, stop = self.section_s
        if stop is not None and stop <= (start or 0.0):
            raise ValueError(f"section_s: ends at {stop:g} s, before it starts; give [start, stop]")
        return self

    def body_from_sensor(self, format_axes: str) -> FloatArray:
        """Return the rotation from sensor axes to the level car, shape (3, 3).

        Args:
            format_axes: Axes of the published format, used where ``axes`` is left out.

        Raises:
            ConfigError: The axes are no right-handed triad.
        """
        axes = format_axes if self.axes is None else self.axes
        if isinstance(axes, Directions):
            permutation = matrix_from_directions(axes.right, axes.forward, axes.up)
        else:
            permutation = matrix_from_letters(axes)
        if self.mounting == Mounting():
            return permutation
        yaw, pitch, roll = (
            math.radians(angle)
            for angle in (self.mounting.yaw_deg, self.mounting.pitch_deg, self.mounting.roll_deg)
        )
        return levelling_matrix(yaw=yaw, pitch=pitch, roll=roll) @ permutation


def load_descriptor(path: Path) -> tuple[Descriptor, Path]:
    """Return a descriptor and the folder or file that it speaks of.

    Args:
        path: YAML file.

    Raises:
        LogNotFoundError: The descriptor does not exist.
        ConfigError: It is not YAML, or an entry is wrong or unknown.
    """
    if not path.is_file():
        raise LogNotFoundError(f"{path}: no such descriptor; give the path of a .yaml file")
    try:
        entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path.name}: not readable as YAML: {error}") from error
    if not isinstance(entries, dict):
        raise ConfigError(f"{path.name}: expected keys and values, such as name, format and path")
    try:
        descriptor = Descriptor.model_validate(entries)
    except ValidationError as error:
        raise ConfigError(f"{path.name}: {_advice(error)}") from None
    return descriptor, _resolve(descriptor.path, path.resolve().parent)


def _resolve(text: str, folder: Path) -> Path:
    default = str(folder / ".." / ".." / "shared" / "data")
    stated = os.environ.get("NAVLEARN_DATA")
    # as of every path that a user states, relative to where he stands
    data = str(Path.cwd() / stated) if stated else default
    return (folder / text.replace("${NAVLEARN_DATA}", data)).resolve()


def _advice(error: ValidationError) -> str:
    lines = []
    for item in error.errors():
        # Axes may be a text or a mapping: what is said of the other kind only confuses.
        if item["loc"][-1:] == ("str",) and isinstance(item["input"], dict):
            continue
        where = ".".join(str(part) for part in item["loc"] if part not in ("Directions", "str"))
        if item["type"] == "extra_forbidden":
            known = _known_keys(item["loc"])
            hint = nearest_hint(str(item["loc"][-1]), known)
            lines.append(f"unknown key {where}{hint}; known are {', '.join(known)}")
        else:
            message = re.sub(r"^Value error, ", "", item["msg"])
            found = f"{where}: {message}, found {item['input']!r}"
            lines.append(found if where else message)
    return "; ".join(lines)


def _known_keys(location: tuple[int | str, ...]) -> list[str]:
    owner: type[BaseModel] = Descriptor
    if location[-3:-2] == ("tables",):
        owner = Table
    elif location[-3:-2] == ("columns",):
        owner = Column
    elif len(location) > 1:
        owners: dict[int | str, type[BaseModel]] = {
            "mounting": Mounting,
            "Directions": Directions,
            "velocity": SpeedAndCourse,
            "satellite": SatelliteName,
            "origin": Origin,
            "reference_latency": ReferenceLatency,
        }
        owner = owners.get(location[-2], Column)
    return sorted(owner.model_fields)
