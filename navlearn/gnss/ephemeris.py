"""What satellites broadcast of their orbits and clocks, and the state computed from it.

All times are GPS seconds (:mod:`navlearn.gnss.gnss_time`). Any origin that is a whole number of
weeks from 6 January 1980 serves as well, for only differences and seconds of week count: times
within the week at hand keep nanometres that ten-digit seconds round to half a millimetre.
"""

from typing import Final, NamedTuple

from torch import Tensor

GRAVITATION: Final[dict[str, float]] = {
    "G": 3.986005e14,
    "J": 3.986005e14,
    "E": 3.986004418e14,
    "C": 3.986004418e14,
    "I": 3.986005e14,
}
"""GM that each Keplerian system's orbits are fitted with, by RINEX letter, m³/s²."""

EARTH_RATE: Final[dict[str, float]] = {
    "G": 7.2921151467e-5,
    "J": 7.2921151467e-5,
    "E": 7.2921151467e-5,
    "C": 7.292115e-5,
    "I": 7.2921151467e-5,
}
"""Rotation rate of the Earth that each system's orbits are fitted with, rad/s."""

BEIDOU_GEOSTATIONARY: Final = frozenset({1, 2, 3, 4, 5, 59, 60, 61, 62, 63})
"""Numbers of BeiDou satellites whose orbits are told in tilted axes."""


class KeplerEphemeris(NamedTuple):
    """Broadcast orbit of GPS, Galileo, BeiDou, QZSS and NavIC satellites, shape (...) each.

    Attributes:
        toe: Reference time of the orbit, GPS seconds.
        toe_of_week: The same on the system's own clock, seconds of its week, s (14 s less than
            GPS for BeiDou).
        toc: Reference time of the clock, GPS seconds.
        clock_bias: a_f0, s.
        clock_drift: a_f1, s/s.
        clock_drift_rate: a_f2, s/s².
        group_delay: What the clock of the code that was measured is behind the broadcast one, s:
            T_GD for GPS L1 C/A, BGD(E1, E5b) or BGD(E1, E5a) for Galileo E1, T_GD1 for BeiDou B1I.
        sqrt_a: Square root of the semi-major axis, √m.
        eccentricity: Eccentricity.
        mean_anomaly: M₀ at ``toe``, rad.
        mean_motion_difference: Δn, rad/s.
        perigee: Argument of perigee ω, rad.
        inclination: i₀ at ``toe``, rad.
        inclination_rate: IDOT, rad/s.
        node: Longitude Ω₀ of the ascending node at the beginning of the week, rad.
        node_rate: Ω̇, rad/s.
        cuc: Cosine harmonic of the argument of latitude, rad.
        cus: Sine harmonic of the same, rad.
        crc: Cosine harmonic of the radius, m.
        crs: Sine harmonic of the same, m.
        cic: Cosine harmonic of the inclination, rad.
        cis: Sine harmonic of the same, rad.
        gravitation: GM of the system, m³/s² (:data:`GRAVITATION`).
        earth_rate: Rotation rate of the Earth of the system, rad/s (:data:`EARTH_RATE`).
        tilted: 1.0 for geostationary satellites of BeiDou, else 0.0.
    """

    toe: Tensor
    toe_of_week: Tensor
    toc: Tensor
    clock_bias: Tensor
    clock_drift: Tensor
    clock_drift_rate: Tensor
    group_delay: Tensor
    sqrt_a: Tensor
    eccentricity: Tensor
    mean_anomaly: Tensor
    mean_motion_difference: Tensor
    perigee: Tensor
    inclination: Tensor
    inclination_rate: Tensor
    node: Tensor
    node_rate: Tensor
    cuc: Tensor
    cus: Tensor
    crc: Tensor
    crs: Tensor
    cic: Tensor
    cis: Tensor
    gravitation: Tensor
    earth_rate: Tensor
    tilted: Tensor


class GlonassEphemeris(NamedTuple):
    """Broadcast state of GLONASS satellites, Earth-fixed axes PZ-90, shape (...) or (..., 3).

    Attributes:
        toe: Reference time t_b, GPS seconds (UTC plus leap seconds).
        position: Position, m, shape (..., 3).
        velocity: Velocity against the Earth, m/s, shape (..., 3).
        acceleration: Acceleration by Sun and Moon, m/s², shape (..., 3).
        clock_bias: −τ_n, s: satellite clock ahead of GLONASS time.
        clock_drift: γ_n, s/s.
    """

    toe: Tensor
    position: Tensor
    velocity: Tensor
    acceleration: Tensor
    clock_bias: Tensor
    clock_drift: Tensor


class SatelliteState(NamedTuple):
    """Where satellites are and how far their clocks are ahead.

    Attributes:
        position: Position, Earth-fixed axes of the moment asked for, m, shape (..., 3).
        velocity: Velocity against the Earth in these axes, m/s, shape (..., 3).
        clock: Satellite clock ahead of its system's time, with relativity, for the code that was
            measured, times the speed of light, m, shape (...).
        clock_rate: Its rate, m/s, shape (...).
    """

    position: Tensor
    velocity: Tensor
    clock: Tensor
    clock_rate: Tensor
