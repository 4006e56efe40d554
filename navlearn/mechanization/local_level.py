"""Short ways in the local level: where they lead on the ellipsoid, and what gravity is there."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth


class Moved(NamedTuple):
    """How geodetic coordinates change along a way, shape (...) each.

    Attributes:
        lat: Change of latitude, rad.
        lon: Change of longitude, rad.
        height: Change of height, m.
    """

    lat: Tensor
    lon: Tensor
    height: Tensor


def gravity_on_the_way(lat: Tensor, height: Tensor, way: Tensor) -> Tensor:
    """Return plumb gravity a short way off, resolved in the local level of the start.

    Args:
        lat: Geodetic latitude of the start, rad, shape (...).
        height: Height of the start, m, shape (...).
        way: Way from the start, east, north, up, m, shape (..., 3).

    Returns:
        Gravity, m/s², shape (..., 3).
    """
    east, north, up = way.unbind(-1)
    tilt_e = east / (earth.prime_vertical_radius(lat) + height)
    tilt_n = north / (earth.meridian_radius(lat) + height)
    raised = 0.5 * (east * tilt_e + north * tilt_n)
    g = earth.normal_gravity(lat + tilt_n, height + up + raised)
    flat = 1.0 - 0.5 * (tilt_e * tilt_e + tilt_n * tilt_n)
    return torch.stack((-g * tilt_e, -g * tilt_n, -g * flat), dim=-1)


def geodetic_change(lat: Tensor, height: Tensor, way: Tensor) -> Moved:
    """Return how latitude, longitude and height change along a short straight way.

    The way out of the meridian plane turns the plane and lifts the end away from the axis; in the
    plane the end is brought to the ellipsoid with the curvature of the middle. Exact to rounding
    for 100 m, to a micrometre for 3 km.

    Args:
        lat: Geodetic latitude of the start, rad, shape (...).
        height: Height of the start, m, shape (...).
        way: Way from the start, east, north, up, m, shape (..., 3).

    Returns:
        Changes of latitude, longitude and height.
    """
    east, north, up = way.unbind(-1)
    sin_lat, cos_lat = torch.sin(lat), torch.cos(lat)
    level = (earth.prime_vertical_radius(lat) + height + up) * cos_lat - north * sin_lat
    lon = torch.atan(east / level)
    lifted = 0.5 * east * lon
    north, up = north - sin_lat * lifted, up + cos_lat * lifted
    guess = north / (earth.meridian_radius(lat) + height + up)
    angle = torch.atan(north / (earth.meridian_radius(lat + 0.5 * guess) + height + up))
    return Moved(angle, lon, up + 0.5 * north * angle)
