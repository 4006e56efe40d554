"""Shape, rotation and gravity of the Earth.

Source: [Groves2013] §2.4; gravity by Somigliana with the free-air term of [NGA2014] Eq. (4-3).
"""

import torch
from torch import Tensor

from navlearn import wgs84


def meridian_radius(lat: Tensor) -> Tensor:
    """Return the meridian radius of curvature R_M.

    [Groves2013] Eq. (2.105).

    Args:
        lat: Geodetic latitude, rad, shape (...).

    Returns:
        Radius, m, shape (...).
    """
    w = 1.0 - wgs84.ECCENTRICITY_SQUARED * torch.sin(lat) ** 2
    return wgs84.SEMI_MAJOR_AXIS * (1.0 - wgs84.ECCENTRICITY_SQUARED) / (w * torch.sqrt(w))


def prime_vertical_radius(lat: Tensor) -> Tensor:
    """Return the prime-vertical radius of curvature R_N.

    [Groves2013] Eq. (2.106).

    Args:
        lat: Geodetic latitude, rad, shape (...).

    Returns:
        Radius, m, shape (...).
    """
    w = 1.0 - wgs84.ECCENTRICITY_SQUARED * torch.sin(lat) ** 2
    return wgs84.SEMI_MAJOR_AXIS / torch.sqrt(w)


def normal_gravity(lat: Tensor, height: Tensor) -> Tensor:
    """Return normal gravity γ(φ, h).

    Somigliana's closed formula with the second-order free-air term, [NGA2014] Eq. (4-3).

    Args:
        lat: Geodetic latitude, rad, shape (...).
        height: Height above the ellipsoid, m, shape (...).

    Returns:
        Gravity, m/s², positive down, shape (...).
    """
    s2 = torch.sin(lat) ** 2
    surface = (
        wgs84.EQUATORIAL_GRAVITY
        * (1.0 + wgs84.SOMIGLIANA_CONSTANT * s2)
        / torch.sqrt(1.0 - wgs84.ECCENTRICITY_SQUARED * s2)
    )
    linear = 2.0 / wgs84.SEMI_MAJOR_AXIS
    slope = 1.0 + wgs84.FLATTENING + wgs84.GRAVITY_RATIO - 2.0 * wgs84.FLATTENING * s2
    quadratic = 3.0 / wgs84.SEMI_MAJOR_AXIS**2
    return surface * (1.0 - linear * slope * height + quadratic * height**2)


def earth_rate_enu(lat: Tensor) -> Tensor:
    """Return the Earth rate ω_ie resolved in east, north, up.

    [Groves2013] Eq. (2.123), turned from NED.

    Args:
        lat: Geodetic latitude, rad, shape (...).

    Returns:
        Angular rate, rad/s, shape (..., 3).
    """
    zero = torch.zeros_like(lat)
    north = wgs84.EARTH_RATE * torch.cos(lat)
    return torch.stack((zero, north, wgs84.EARTH_RATE * torch.sin(lat)), dim=-1)


def transport_rate_enu(lat: Tensor, height: Tensor, v_e: Tensor, v_n: Tensor) -> Tensor:
    """Return the transport rate ω_el resolved in east, north, up.

    [Groves2013] Eq. (5.44), turned from NED.

    Args:
        lat: Geodetic latitude, rad, shape (...).
        height: Height above the ellipsoid, m, shape (...).
        v_e: Velocity to the east, m/s, shape (...).
        v_n: Velocity to the north, m/s, shape (...).

    Returns:
        Angular rate, rad/s, shape (..., 3).
    """
    east = -v_n / (meridian_radius(lat) + height)
    north = v_e / (prime_vertical_radius(lat) + height)
    return torch.stack((east, north, north * torch.tan(lat)), dim=-1)
