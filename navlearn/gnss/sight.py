"""Where a satellite stands as seen from the car.

Source: [Groves2013] §8.5.4.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import frames


class Sight(NamedTuple):
    """Lines of sight from a car to S satellites, shape (..., S) each unless said otherwise.

    Attributes:
        distance: Straight distance, m.
        unit: Unit vector from car to satellite, east, north, up at the car, shape (..., S, 3).
        elevation: Elevation over the car's horizon, rad.
        azimuth: Azimuth, rad, clockwise from north, in (−π, π]; 0 in the zenith.
    """

    distance: Tensor
    unit: Tensor
    elevation: Tensor
    azimuth: Tensor


def sight(lat: Tensor, lon: Tensor, height: Tensor, satellite: Tensor) -> Sight:
    """Return distance and direction of satellites.

    [Groves2013] §8.5.4, turned from NED. The derivative of distance to the car's
    east, north and up is −``unit``. Angles have derivatives everywhere, zero in the zenith.

    Args:
        lat: Geodetic latitude of the antenna, rad, shape (...).
        lon: Longitude of the antenna, rad, shape (...).
        height: Height of the antenna above the ellipsoid, m, shape (...).
        satellite: Satellites in the Earth-fixed axes in which the car stands (those of the
            moment of reception), m, shape (..., S, 3).
    """
    antenna = frames.ecef_from_geodetic(lat, lon, height)
    away = satellite - antenna.unsqueeze(-2)
    distance = torch.sqrt((away * away).sum(-1))
    turn = frames.enu_from_ecef_matrix(lat, lon)
    unit = torch.matmul(away / distance.unsqueeze(-1), turn.transpose(-1, -2))
    east, north, up = unit.unbind(-1)
    level = east * east + north * north
    zenith = level < 1e-24
    level = torch.sqrt(torch.where(zenith, torch.ones_like(level), level))
    elevation = torch.atan2(up, torch.where(zenith, torch.zeros_like(level), level))
    azimuth = torch.atan2(east, torch.where(zenith, torch.ones_like(north), north))
    azimuth = torch.where(zenith, torch.zeros_like(azimuth), azimuth)
    return Sight(distance, unit, elevation, azimuth)
