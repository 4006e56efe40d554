"""Units that logs are published in, and their factors to SI and radians."""

import math
from typing import Final

from navlearn.errors import ConfigError
from navlearn.logs.nearest import nearest_hint

STANDARD_GRAVITY: Final = 9.80665

FACTORS: Final[dict[str, dict[str, float]]] = {
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "1e-7deg": 1e-7 * math.pi / 180.0},
    "angular rate": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180.0,
        "mrad/s": 1e-3,
        "deg/h": math.pi / 180.0 / 3600.0,
    },
    "speed": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "knot": 1852.0 / 3600.0, "cm/s": 0.01},
    "acceleration": {
        "m/s2": 1.0,
        "m/s^2": 1.0,
        "g": STANDARD_GRAVITY,
        "mg": 1e-3 * STANDARD_GRAVITY,
    },
    "length": {"m": 1.0, "cm": 0.01, "mm": 1e-3, "km": 1e3, "ft": 0.3048},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "temperature": {"degC": 1.0},
    "number": {"1": 1.0},
}
"""Factor by unit, per kind of quantity."""

_SUFFIXES: Final[dict[str, str]] = {
    "deg": "deg",
    "rad": "rad",
    "deg_per_s": "deg/s",
    "rad_per_s": "rad/s",
    "deg_per_h": "deg/h",
    "kmh": "km/h",
    "km_per_h": "km/h",
    "mps": "m/s",
    "m_per_s": "m/s",
    "m_per_s2": "m/s2",
    "mph": "mph",
    "knots": "knot",
    "g": "g",
    "mg": "mg",
    "m": "m",
    "cm": "cm",
    "mm": "mm",
    "ft": "ft",
    "s": "s",
    "ms": "ms",
    "us": "us",
    "ns": "ns",
}
"""Unit by the suffix of a column's name, as in ``lat_deg`` or ``gyro_z_deg_per_s``."""


_SPEEDS: Final = ("speed", "std_v", "range_rate", "std_rate", "sat_clock_rate")
_LENGTHS: Final = (
    *("height", "east", "north", "up"),
    *("pseudorange", "ionosphere", "troposphere"),
)


def kind_of(column: str) -> str:
    """Return the kind of quantity that a canonical column holds.

    Args:
        column: Canonical name of :mod:`navlearn.logs.columns`.
    """
    if column == "t":
        return "time"
    if column in ("lat", "lon", "azimuth", "pitch", "roll", "course"):
        return "angle"
    if column.startswith("gyro_"):
        return "angular rate"
    if column.startswith("accel_"):
        return "acceleration"
    if column in _SPEEDS or column.startswith(("v_", "sat_v")):
        return "speed"
    if column in _LENGTHS or column.startswith(("std_", "sat_")):
        return "length"
    return "temperature" if column == "temperature" else "number"


def factor_to_si(unit: str, column: str) -> float:
    """Return what a value in a unit is multiplied by to give the canonical unit.

    Args:
        unit: Name of the unit, such as ``deg/s``.
        column: Canonical column that the value goes to.

    Returns:
        The factor.

    Raises:
        ConfigError: The unit is unknown or of another kind than the column.
    """
    factors = FACTORS[kind_of(column)]
    if unit in factors:
        return factors[unit]
    known = ", ".join(factors)
    raise ConfigError(
        f"column {column}: unit {unit!r} is no unit of {kind_of(column)}"
        f"{nearest_hint(unit, factors)}; known are {known}"
    )


def split_suffix(name: str, columns: set[str]) -> tuple[str, str] | None:
    """Return canonical column and unit of a name such as ``speed_kmh``.

    Args:
        name: Column name as found in a file.
        columns: Canonical names of the table.

    Returns:
        The column and the unit that its suffix names, or None where the name is not of that form.
    """
    for column in sorted(columns, key=len, reverse=True):
        unit = _SUFFIXES.get(name.removeprefix(f"{column}_"))
        if name.startswith(f"{column}_") and unit in FACTORS[kind_of(column)]:
            return column, unit
    return None
