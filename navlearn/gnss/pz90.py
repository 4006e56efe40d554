"""Constants of PZ-90, the Earth of GLONASS.

Source: [GLONASSICD] table 3.2. Scripted code reads these as module attributes.
"""

GRAVITATIONAL_CONSTANT: float = 3.986004418e14
"""Geocentric gravitational constant GM, m³/s²."""

SEMI_MAJOR_AXIS: float = 6378136.0
"""Equatorial radius, m."""

OBLATENESS: float = 1.08262575e-3
"""Second zonal harmonic J₂."""

EARTH_RATE: float = 7.292115e-5
"""Rotation rate of the Earth, rad/s."""
