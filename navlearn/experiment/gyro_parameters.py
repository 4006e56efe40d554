"""What a filter knows of its gyro, in the units of a data sheet."""

import math

from navlearn.filters.belief import Belief
from navlearn.fusion.error_state import error_layout
from navlearn.fusion.options import EkfOptions

UNITS = {
    "bias": ("deg/h", math.degrees(3600.0)),
    "scale": ("%", 100.0),
    "abs_scale": ("%", 100.0),
    "quadratic": ("% per rad/s", 100.0),
    "f_x": ("deg/s per g", math.degrees(9.80665)),
    "f_y": ("deg/s per g", math.degrees(9.80665)),
    "temperature": ("deg/h per K", math.degrees(3600.0)),
}
"""Unit in which a reader knows a gyro term, and what turns SI into it."""


def readable_parameters(options: EkfOptions, belief: Belief) -> dict[str, str]:
    """Return value, standard deviation and unit of every gyro state, by term.

    Args:
        options: The filter's.
        belief: What it believed, no batch axes.
    """
    layout = error_layout(options)
    told = {}
    for term in options.gyro_states:
        at = layout.sensors.index(f"gyro_{term}")
        row = layout.first_sensor + at
        variance = belief.covariance[row, row].clamp(min=0.0)
        told[term] = readable(term, float(belief.sensor[at]), float(variance.sqrt()))
    return told


def readable(term: str, value: float, sigma: float) -> str:
    """Return one parameter as a data sheet would write it.

    Args:
        term: Name of the gyro term.
        value: SI.
        sigma: Its standard deviation, SI.
    """
    unit, factor = UNITS[term]
    return f"{factor * value:+.3g} ± {factor * sigma:.2g} {unit}"
