"""Constants of the World Geodetic System 1984.

Source: NGA.STND.0036 (2014), tables 3.1 to 3.6. Scripted code reads these as module
attributes (``wgs84.SEMI_MAJOR_AXIS``), never as bare names.
"""

SEMI_MAJOR_AXIS: float = 6378137.0
"""Equatorial radius a, m."""

FLATTENING: float = 1.0 / 298.257223563
"""Flattening f of the ellipsoid."""

ECCENTRICITY_SQUARED: float = FLATTENING * (2.0 - FLATTENING)
"""First eccentricity squared e²."""

SEMI_MINOR_AXIS: float = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
"""Polar radius b, m."""

EARTH_RATE: float = 7.292115e-5
"""Rotation rate of the Earth ω_e, rad/s."""

GRAVITATIONAL_CONSTANT: float = 3.986004418e14
"""Geocentric gravitational constant GM, m³/s²."""

EQUATORIAL_GRAVITY: float = 9.7803253359
"""Normal gravity at the equator γ_e, m/s²."""

POLAR_GRAVITY: float = 9.8321849378
"""Normal gravity at the poles γ_p, m/s²."""

SOMIGLIANA_CONSTANT: float = (
    SEMI_MINOR_AXIS * POLAR_GRAVITY / (SEMI_MAJOR_AXIS * EQUATORIAL_GRAVITY) - 1.0
)
"""k of Somigliana's formula."""

GRAVITY_RATIO: float = EARTH_RATE**2 * SEMI_MAJOR_AXIS**2 * SEMI_MINOR_AXIS / GRAVITATIONAL_CONSTANT
"""m = ω² a² b / GM of the free-air term."""
