"""A car's motion as smooth functions: speed and azimuth of time, slope and crossfall of distance.

All are uniform quintic B-splines whose coefficients are the commanded values. Such a spline
stays inside the range of its coefficients, its derivative inside the range of their
differences, and it is exactly constant where six neighbours are equal: limits on the command
are limits on the motion, and a stop is a true standstill.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from navlearn.logs.synthetic.draws import Array

KNOT_INTERVAL = 0.5
"""Between the coefficients of speed and azimuth, s."""

KNOT_DISTANCE = 10.0
"""Between the coefficients of slope and crossfall, m."""

_DEGREE = 5
_PAD = 3


class Kinematics(NamedTuple):
    """Speed and attitude with their rates, shape (N,) each.

    Attributes:
        speed: Along the forward axis, m/s, never negative.
        acceleration: Its rate, m/s².
        azimuth: Azimuth, rad, clockwise from north, not wrapped.
        azimuth_rate: Its rate, rad/s.
        pitch: Pitch, rad, nose up.
        pitch_rate: Its rate, rad/s.
        roll: Roll, rad, right side down.
        roll_rate: Its rate, rad/s.
    """

    speed: Array
    acceleration: Array
    azimuth: Array
    azimuth_rate: Array
    pitch: Array
    pitch_rate: Array
    roll: Array
    roll_rate: Array


def uniform_spline(command: Callable[[Array], Array], end: float, interval: float) -> Any:
    """Return the quintic B-spline that smooths a command over [0, end].

    Args:
        command: The commanded value at given abscissae, also a little outside [0, end].
        end: End of the domain.
        interval: Between coefficients, in the unit of the abscissa.
    """
    count = int(np.ceil(end / interval)) + 2 * _PAD + 1
    where = np.arange(-_PAD, count - _PAD, dtype=np.float64) * interval
    coefficients = command(where)
    knots = (np.arange(count + _DEGREE + 1) - _PAD - (_DEGREE + 1) // 2) * interval
    return BSpline(knots, coefficients, _DEGREE, extrapolate=False)


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What a car does over a drive; the velocity lies along the forward axis.

    Attributes:
        duration: Length of the drive, s.
        speed: Spline of speed over time, m/s.
        azimuth: Spline of azimuth over time, rad.
        slope: Spline of the road's slope over distance, rad, climbing positive: the pitch.
        crossfall: Spline of the road's crossfall over distance, rad, right side down.
        roll_gradient: Roll of the body per centripetal acceleration, rad/(m/s²); it leans
            outwards.
        origin: Where it starts, latitude (rad), longitude (rad), height (m), where that is part
            of the motion.
        description: One sentence on what is driven, for the log's metadata.
    """

    duration: float
    speed: Any
    azimuth: Any
    slope: Any
    crossfall: Any
    roll_gradient: float = 0.008
    origin: tuple[float, float, float] | None = None
    description: str = ""

    def at(self, t: Array) -> Kinematics:
        """Return speed and attitude at given times.

        Args:
            t: Times within [0, duration], s, shape (N,).
        """
        distance = self.speed.antiderivative()
        # The antiderivative counts from its first knot, the road from the start of the drive.
        s = np.clip(distance(t) - distance(0.0), 0.0, None)
        speed, acceleration = self.speed(t), self.speed.derivative(1)(t)
        rate, rate_change = self.azimuth.derivative(1)(t), self.azimuth.derivative(2)(t)
        lean = -self.roll_gradient * speed * rate
        lean_rate = -self.roll_gradient * (acceleration * rate + speed * rate_change)
        return Kinematics(
            speed=speed,
            acceleration=acceleration,
            azimuth=self.azimuth(t),
            azimuth_rate=rate,
            pitch=self.slope(s),
            pitch_rate=self.slope.derivative(1)(s) * speed,
            roll=self.crossfall(s) + lean,
            roll_rate=self.crossfall.derivative(1)(s) * speed + lean_rate,
        )
