"""Delay of the troposphere in a standard atmosphere.

Zenith delays of [Saastamoinen1972] in the form of [Davis1985]; pressure and temperature of the
International Standard Atmosphere; mapping to low elevations of [BlackEisner1984], the one that
[RTCA2016] prescribes, within 1.1 % of that of Niell from 5 degrees up.
"""

import torch
from torch import Tensor


def zenith_delays(
    lat: Tensor, height: Tensor, relative_humidity: float = 0.5
) -> tuple[Tensor, Tensor]:
    """Return the hydrostatic and the wet delay straight up.

    [Davis1985] Appendix A for the hydrostatic, [Saastamoinen1972] for the wet part.

    Args:
        lat: Geodetic latitude, rad, shape (...).
        height: Height of the antenna, m, shape (...).
        relative_humidity: Of the air at the antenna, 0 to 1.

    Returns:
        Hydrostatic and wet delay, m, each of shape (...).
    """
    # the pressure has no value far outside, where an iteration may start
    height = height.clamp(-1000.0, 40000.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * height) ** 5.2568
    temperature = (288.15 - 6.5e-3 * height).clamp_min(216.65)
    vapour = (
        6.108
        * relative_humidity
        * torch.exp((17.15 * temperature - 4684.0) / (temperature - 38.45))
    )
    gravity = 1.0 - 0.00266 * torch.cos(2.0 * lat) - 0.00028e-3 * height
    return 0.0022768 * pressure / gravity, 0.002277 * (1255.0 / temperature + 0.05) * vapour


def slant_factor(elevation: Tensor) -> Tensor:
    """Return how much longer the way through the troposphere is than straight up.

    [BlackEisner1984] as given in [RTCA2016] §A.4.2.4; below the horizon as on it.

    Args:
        elevation: Elevation, rad, shape (...).

    Returns:
        Factor, 1 in the zenith, shape (...).
    """
    return 1.001 / torch.sqrt(0.002001 + torch.sin(elevation.clamp_min(0.0)) ** 2)


def saastamoinen_delay(lat: Tensor, height: Tensor, elevation: Tensor) -> Tensor:
    """Return the delay by the troposphere in a standard atmosphere of 50 % humidity.

    Args:
        lat: Geodetic latitude of the antenna, rad, shape that broadcasts with ``elevation``.
        height: Height of the antenna, m, shape as ``lat``.
        elevation: Elevation of the satellite, rad, shape (...).

    Returns:
        Delay, m, taken off a pseudorange, shape (...).
    """
    hydrostatic, wet = zenith_delays(lat, height)
    return (hydrostatic + wet) * slant_factor(elevation)
