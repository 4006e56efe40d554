"""Places, gravity and local level in an Earth-fixed frame, channel by channel, without sines.

The frame stands in the Earth's centre, z along its axis, x in the meridian of a start. Bowring's
angle is kept by its sine and cosine, so roots replace all but two arcs.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84

Vector = tuple[Tensor, Tensor, Tensor]


class Plumb(NamedTuple):
    """The ellipsoid's normal through places, shape (...) each.

    Attributes:
        sin_lat: Sine of geodetic latitude.
        cos_lat: Its cosine.
        axis: Distance from the Earth's axis, m.
        height: Height above the ellipsoid, m.
    """

    sin_lat: Tensor
    cos_lat: Tensor
    axis: Tensor
    height: Tensor


def place_in_meridian(sin_lat: Tensor, cos_lat: Tensor, height: Tensor) -> tuple[Tensor, Tensor]:
    """Return how far a place lies from the Earth's axis and above the equator's plane.

    [Groves2013] Eq. (2.112).

    Args:
        sin_lat: Sine of geodetic latitude, shape (...).
        cos_lat: Its cosine, shape (...).
        height: Height above the ellipsoid, m, shape (...).

    Returns:
        Distance from the axis and along it, m, shape (...) each.
    """
    e2 = wgs84.ECCENTRICITY_SQUARED
    r_n = wgs84.SEMI_MAJOR_AXIS * torch.rsqrt(1.0 - e2 * sin_lat * sin_lat)
    return (r_n + height) * cos_lat, ((1.0 - e2) * r_n + height) * sin_lat


def level_to_meridian(
    sin_lat: Tensor, cos_lat: Tensor, half_cos: Tensor, half_sin: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the quaternion that turns local level into a meridian frame.

    Args:
        sin_lat: Sine of latitude, shape (...).
        cos_lat: Cosine of latitude, shape (...).
        half_cos: Cosine of half the angle by which the place lies east of the frame's x axis.
        half_sin: Its sine.

    Returns:
        Scalar-first components, shape (...) each.
    """
    # q_z(angle + π/2) q_x(π/2 − lat), by half angles without another sine
    up = torch.sqrt(0.5 + 0.5 * sin_lat)
    out = 0.5 * cos_lat / up
    root = math.sqrt(0.5)
    cos, sin = root * (half_cos - half_sin), root * (half_cos + half_sin)
    return cos * up, cos * out, sin * out, sin * up


def plumb_line(x: Tensor, y: Tensor, z: Tensor) -> Plumb:
    """Return latitude and height of places.

    Bowring 1976, two passes, as :func:`navlearn.frames.geodetic_from_ecef`.

    Args:
        x: Coordinate in the meridian plane, m, shape (...).
        y: Coordinate across it, m, shape (...).
        z: Coordinate along the axis, m, shape (...).

    Returns:
        The plumb line, shape (...) each.
    """
    a, b, e2 = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS, wgs84.ECCENTRICITY_SQUARED
    axis = torch.sqrt(torch.addcmul(x * x, y, y))
    up, out = a * z, b * axis
    sin_lat, cos_lat = up, out
    for _ in range(2):
        per = torch.rsqrt(torch.addcmul(up * up, out, out))
        sin_beta, cos_beta = up * per, out * per
        up = z + (e2 / (1.0 - e2) * b) * sin_beta * sin_beta * sin_beta
        out = axis - (e2 * a) * cos_beta * cos_beta * cos_beta
        sin_lat, cos_lat = up, out
        up = (1.0 - wgs84.FLATTENING) * up
    per = torch.rsqrt(torch.addcmul(sin_lat * sin_lat, cos_lat, cos_lat))
    sin_lat, cos_lat = sin_lat * per, cos_lat * per
    curve = a * torch.sqrt(1.0 - e2 * sin_lat * sin_lat)
    return Plumb(sin_lat, cos_lat, axis, axis * cos_lat + z * sin_lat - curve)


def gravity_at(x: Tensor, y: Tensor, z: Tensor) -> Vector:
    """Return normal gravity along the plumb line.

    As :func:`navlearn.earth.normal_gravity`, from the sine of latitude.

    Args:
        x: Coordinate in the meridian plane, m, shape (...).
        y: Coordinate across it, m, shape (...).
        z: Coordinate along the axis, m, shape (...).

    Returns:
        Gravity along x, y and z, m/s², shape (...) each.
    """
    sin_lat, cos_lat, axis, height = plumb_line(x, y, z)
    square = sin_lat * sin_lat
    root = torch.rsqrt(1.0 - wgs84.ECCENTRICITY_SQUARED * square)
    surface = (1.0 + wgs84.SOMIGLIANA_CONSTANT * square) * root
    slope = (1.0 + wgs84.FLATTENING + wgs84.GRAVITY_RATIO) - (2.0 * wgs84.FLATTENING) * square
    high = height * (1.0 / wgs84.SEMI_MAJOR_AXIS)
    free_air = 1.0 + high * (3.0 * high - 2.0 * slope)
    down = (-wgs84.EQUATORIAL_GRAVITY) * surface * free_air
    level = down * cos_lat / axis
    return level * x, level * y, down * sin_lat
