"""Positions on the Earth: geodetic, Earth-fixed Cartesian, local metres.

Source: [Groves2013] §2.4.3; the inverse is Bowring's with two passes, exact to rounding (4e-9 m)
from the equator to the poles for any height a car reaches.
"""

import math

import torch
from torch import Tensor

from navlearn import earth, wgs84


def ecef_from_geodetic(lat: Tensor, lon: Tensor, height: Tensor) -> Tensor:
    """Return the Earth-centred Earth-fixed position.

    [Groves2013] Eq. (2.112).

    Args:
        lat: Geodetic latitude, rad, shape (...).
        lon: Longitude, rad, shape (...).
        height: Height above the ellipsoid, m, shape (...).

    Returns:
        Position, m, shape (..., 3).
    """
    r_n = earth.prime_vertical_radius(lat)
    x = (r_n + height) * torch.cos(lat) * torch.cos(lon)
    y = (r_n + height) * torch.cos(lat) * torch.sin(lon)
    z = ((1.0 - wgs84.ECCENTRICITY_SQUARED) * r_n + height) * torch.sin(lat)
    return torch.stack((x, y, z), dim=-1)


def geodetic_from_ecef(position: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return latitude, longitude and height of an Earth-fixed position.

    Bowring 1976 on the parametric latitude, two passes.

    Args:
        position: Earth-centred Earth-fixed position, m, shape (..., 3).

    Returns:
        Latitude (rad), longitude (rad), height (m), each of shape (...).
    """
    x, y, z = position.unbind(-1)
    p = torch.sqrt(x * x + y * y)
    a, b = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS
    e2 = wgs84.ECCENTRICITY_SQUARED
    beta = torch.atan2(a * z, b * p)
    lat = beta
    for _ in range(2):
        lat = torch.atan2(
            z + e2 / (1.0 - e2) * b * torch.sin(beta) ** 3, p - e2 * a * torch.cos(beta) ** 3
        )
        beta = torch.atan2((1.0 - wgs84.FLATTENING) * torch.sin(lat), torch.cos(lat))
    s = torch.sin(lat)
    height = p * torch.cos(lat) + z * s - a * torch.sqrt(1.0 - e2 * s * s)
    return lat, torch.atan2(y, x), height


def enu_from_ecef_matrix(lat: Tensor, lon: Tensor) -> Tensor:
    """Return C_le, which turns Earth-fixed vectors into east, north, up.

    [Groves2013] Eq. (2.150), turned from NED.

    Args:
        lat: Geodetic latitude, rad, shape (...).
        lon: Longitude, rad, shape (...).

    Returns:
        Rotation matrix, shape (..., 3, 3).
    """
    sp, cp, sl, cl = torch.sin(lat), torch.cos(lat), torch.sin(lon), torch.cos(lon)
    zero = torch.zeros_like(lat)
    east = torch.stack((-sl, cl, zero), dim=-1)
    north = torch.stack((-sp * cl, -sp * sl, cp), dim=-1)
    up = torch.stack((cp * cl, cp * sl, sp), dim=-1)
    return torch.stack((east, north, up), dim=-2)


def enu_between(
    lat: Tensor, lon: Tensor, height: Tensor, lat_0: Tensor, lon_0: Tensor, height_0: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return how far a position lies east, north and above a nearby one.

    First order on the ellipsoid (radii at the mean latitude): a millimetre over 1 km,
    the size of difference that errors and innovations have. Across the antimeridian the way is
    the short one, whichever longitudes name the places.

    Args:
        lat: Latitude, rad, shape (...).
        lon: Longitude, rad, any number of turns, shape (...).
        height: Height, m, shape (...).
        lat_0: Latitude of the origin, rad, shape (...).
        lon_0: Longitude of the origin, rad, shape (...).
        height_0: Height of the origin, m, shape (...).

    Returns:
        East, north and up difference, m, each of shape (...).
    """
    mid_lat, mid_height = 0.5 * (lat + lat_0), 0.5 * (height + height_0)
    north = (lat - lat_0) * (earth.meridian_radius(mid_lat) + mid_height)
    radius = (earth.prime_vertical_radius(mid_lat) + mid_height) * torch.cos(mid_lat)
    return _short_way(lon - lon_0) * radius, north, height - height_0


def shift_between(
    lat: Tensor, lon: Tensor, height: Tensor, lat_0: Tensor, lon_0: Tensor, height_0: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the shift by which :func:`shift_geodetic` leads from one position to another.

    As :func:`enu_between`, but with the radii where the way begins, so that the inverse is exact.

    Args:
        lat: Latitude of where it leads, rad, shape (...).
        lon: Longitude, rad, any number of turns, shape (...).
        height: Height, m, shape (...).
        lat_0: Latitude of where it begins, rad, shape (...).
        lon_0: Longitude of where it begins, rad, shape (...).
        height_0: Height of where it begins, m, shape (...).

    Returns:
        Way to the east, to the north and up, m, each of shape (...).
    """
    north = (lat - lat_0) * (earth.meridian_radius(lat_0) + height_0)
    radius = (earth.prime_vertical_radius(lat_0) + height_0) * torch.cos(lat_0)
    return _short_way(lon - lon_0) * radius, north, height - height_0


def _short_way(around: Tensor) -> Tensor:
    # exact, and quicker than a remainder, where there is no turn to take off
    turns = torch.round(around * (0.5 / math.pi))
    return torch.sub(around, turns, alpha=2.0 * math.pi)


def shift_geodetic(
    lat: Tensor, lon: Tensor, height: Tensor, east: Tensor, north: Tensor, up: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return a position moved by a short way east, north and up.

    Inverse of :func:`shift_between`, and of :func:`enu_between` to first order.

    Args:
        lat: Latitude, rad, shape (...).
        lon: Longitude, rad, shape (...).
        height: Height, m, shape (...).
        east: Way to the east, m, shape (...).
        north: Way to the north, m, shape (...).
        up: Way up, m, shape (...).

    Returns:
        Latitude (rad), longitude (rad), height (m), each of shape (...).
    """
    lat_1 = lat + north / (earth.meridian_radius(lat) + height)
    radius = (earth.prime_vertical_radius(lat) + height) * torch.cos(lat)
    return lat_1, lon + east / radius, height + up
