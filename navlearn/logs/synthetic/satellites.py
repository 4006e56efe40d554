"""Satellites on Kepler orbits, and when they sent what a car receives.

Constellations have the shape of the real ones: evenly spread planes, satellites evenly spread in
a plane and shifted from plane to plane, orbits a little eccentric. They are nobody's satellites:
a number names a place in the pattern.
"""

import math
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn import frames, wgs84
from navlearn.gnss.earth_rotation import in_axes_of_reception
from navlearn.gnss.sight import sight
from navlearn.gnss.signals import SPEED_OF_LIGHT
from navlearn.logs.synthetic.draws import Array

EPOCH: Final = 2400.0 * 604800.0
"""When the first satellite of every plane passes its pattern's start, GPS seconds."""

_PASSES = 4


class Pattern(NamedTuple):
    """A constellation: planes evenly round the equator.

    Attributes:
        planes: Number of planes.
        per_plane: Satellites in each.
        phase: Shift of a plane's satellites against those of the plane to its west, in units of
            one turn over the number of satellites.
        semi_major_axis: Of the orbits, m.
        inclination: Of the planes, rad.
        first_node: Longitude of the first ascending node at :data:`EPOCH`, rad.
        eccentricity: Largest eccentricity; satellites have some of it.
    """

    planes: int
    per_plane: int
    phase: int
    semi_major_axis: float
    inclination: float
    first_node: float
    eccentricity: float


PATTERNS: Final = {
    "G": Pattern(6, 5, 2, 26_559_700.0, math.radians(55.0), 0.3, 0.012),
    "E": Pattern(3, 8, 1, 29_599_800.0, math.radians(56.0), 1.1, 0.0005),
    "R": Pattern(3, 8, 1, 25_508_000.0, math.radians(64.8), 0.7, 0.002),
}
"""Patterns of GPS, Galileo and GLONASS, by RINEX letter."""


class Orbits(NamedTuple):
    """Kepler orbits of S satellites, shape (S,) each.

    Attributes:
        semi_major_axis: m.
        eccentricity: Dimensionless.
        inclination: rad.
        node: Longitude of the ascending node at :data:`EPOCH`, in Earth-fixed axes, rad.
        perigee: Argument of perigee, rad.
        mean_anomaly: At :data:`EPOCH`, rad.
    """

    semi_major_axis: Tensor
    eccentricity: Tensor
    inclination: Tensor
    node: Tensor
    perigee: Tensor
    mean_anomaly: Tensor


class Signals(NamedTuple):
    """What M receptions take in from S satellites, visible or not; shape (M, S) each.

    Attributes:
        position: Satellite when it sent, Earth-fixed axes of that moment, m, shape (M, S, 3).
        velocity: Its velocity against the Earth in the same axes, m/s, shape (M, S, 3).
        distance: From the satellite when it sent to the antenna at reception, m.
        rate: Derivative of the distance to the time of reception, m/s.
        elevation: Elevation over the horizon, rad.
        azimuth: Azimuth, rad, clockwise from north.
    """

    position: Array
    velocity: Array
    distance: Array
    rate: Array
    elevation: Array
    azimuth: Array


def constellation(system: str) -> tuple[tuple[str, ...], Orbits]:
    """Return the satellites of a system.

    Args:
        system: RINEX letter, of :data:`PATTERNS`.

    Returns:
        Their names, such as G01, and their orbits.
    """
    pattern = PATTERNS[system]
    count = pattern.planes * pattern.per_plane
    number = np.arange(count)
    plane, place = number // pattern.per_plane, number % pattern.per_plane
    turn = 2.0 * math.pi
    # Spread over what real orbits have, always the same.
    spread = np.mod(number * 0.618034, 1.0)
    perigee = turn * np.mod(number * 0.414214, 1.0)
    argument = turn * (place / pattern.per_plane + plane * pattern.phase / count)
    values = (
        np.full(count, pattern.semi_major_axis),
        pattern.eccentricity * spread,
        np.full(count, pattern.inclination),
        pattern.first_node + turn * plane / pattern.planes,
        perigee,
        argument - perigee,
    )
    names = tuple(f"{system}{n + 1:02d}" for n in number)
    return names, Orbits(*(torch.tensor(v, dtype=torch.float64) for v in values))


def orbit_state(orbits: Orbits, gps_seconds: Tensor) -> tuple[Tensor, Tensor]:
    """Return position and velocity of satellites.

    [ISGPS200] §20.3.3.4.3 without the harmonic corrections.

    Args:
        orbits: Orbits, shape (S,).
        gps_seconds: Times, GPS seconds, shape (..., S).

    Returns:
        Position (m) and velocity against the Earth (m/s) in Earth-fixed axes of the moment, shape
        (..., S, 3) each.
    """
    elapsed = gps_seconds - EPOCH
    motion = torch.sqrt(wgs84.GRAVITATIONAL_CONSTANT / orbits.semi_major_axis**3)
    mean = orbits.mean_anomaly + motion * elapsed
    e = orbits.eccentricity
    eccentric = mean
    for _ in range(8):
        eccentric = mean + e * torch.sin(eccentric)
    root = torch.sqrt(1.0 - e * e)
    s, c = torch.sin(eccentric), torch.cos(eccentric)
    rate = motion / (1.0 - e * c)
    a = orbits.semi_major_axis
    along, across = a * (c - e), a * root * s
    along_dot, across_dot = -a * s * rate, a * root * c * rate
    sw, cw = torch.sin(orbits.perigee), torch.cos(orbits.perigee)
    x, y = cw * along - sw * across, sw * along + cw * across
    x_dot, y_dot = cw * along_dot - sw * across_dot, sw * along_dot + cw * across_dot
    node = orbits.node - wgs84.EARTH_RATE * elapsed
    sn, cn = torch.sin(node), torch.cos(node)
    si, ci = torch.sin(orbits.inclination), torch.cos(orbits.inclination)
    position = torch.stack((x * cn - y * ci * sn, x * sn + y * ci * cn, y * si), dim=-1)
    turned = torch.stack(
        (x_dot * cn - y_dot * ci * sn, x_dot * sn + y_dot * ci * cn, y_dot * si), dim=-1
    )
    return position, turned - _earth_turn(position)


def signals(
    orbits: Orbits, gps_seconds: Array, place: tuple[Array, Array, Array], v_l: Array
) -> Signals:
    """Return what an antenna takes in from satellites.

    The time of sending is found from the distance by iteration; the rate of the distance counts
    that the time of sending moves less than that of reception where the satellite recedes.

    Args:
        orbits: Orbits, shape (S,).
        gps_seconds: Times of reception, GPS seconds, shape (M,).
        place: Latitude (rad), longitude (rad) and height (m) of the antenna, shape (M,) each.
        v_l: Its velocity, east, north, up, m/s, shape (M, 3).
    """
    lat, lon, height = (torch.from_numpy(np.ascontiguousarray(a)) for a in place)
    antenna = frames.ecef_from_geodetic(lat, lon, height)[:, None, :]
    c_le = frames.enu_from_ecef_matrix(lat, lon)
    moving = torch.einsum("mij,mi->mj", c_le, torch.from_numpy(v_l))[:, None, :]
    at = torch.from_numpy(gps_seconds)[:, None]
    travel = torch.full((at.shape[0], orbits.node.shape[0]), 0.075, dtype=torch.float64)
    for _ in range(_PASSES):
        position, velocity = orbit_state(orbits, at - travel)
        here = in_axes_of_reception(position, travel)
        travel = torch.linalg.vector_norm(here - antenna, dim=-1) / SPEED_OF_LIGHT
    seen = sight(lat, lon, height, here)
    unit = (here - antenna) / seen.distance[..., None]
    sent = in_axes_of_reception(velocity, travel)
    # d(here)/dt = sent (1 − τ') − (ω × here) τ', and τ' = rate / c.
    drag = (unit * (sent + _earth_turn(here))).sum(-1) / SPEED_OF_LIGHT
    rate = (unit * (sent - moving)).sum(-1) / (1.0 + drag)
    found = (position, velocity, seen.distance, rate, seen.elevation, seen.azimuth)
    return Signals(*(a.numpy() for a in found))


def _earth_turn(position: Tensor) -> Tensor:
    x, y, z = position.unbind(-1)
    return wgs84.EARTH_RATE * torch.stack((-y, x, torch.zeros_like(z)), dim=-1)
