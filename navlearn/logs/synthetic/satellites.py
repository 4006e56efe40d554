"""Satellites on Kepler orbits, and when they sent what a car receives.

Constellations have the shape of the real ones: evenly spread planes, satellites evenly spread in
a plane and shifted from plane to plane, orbits a little eccentric and undisturbed. They are
nobody's satellites: a number names a place in the pattern.
"""

import math
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn import frames, wgs84
from navlearn.gnss.earth_rotation import in_axes_of_reception
from navlearn.gnss.ephemeris import KeplerEphemeris
from navlearn.gnss.gnss_time import WEEK
from navlearn.gnss.kepler import kepler_state
from navlearn.gnss.sight import sight
from navlearn.gnss.signals import SPEED_OF_LIGHT
from navlearn.logs.synthetic.draws import Array

EPOCH: Final = 2400.0 * WEEK
"""When every pattern is as it is stated, GPS seconds."""

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
    "G": Pattern(6, 5, 1, 26_559_700.0, math.radians(55.0), 0.3, 0.012),
    "E": Pattern(3, 8, 1, 29_599_800.0, math.radians(56.0), 1.1, 0.0005),
    "R": Pattern(3, 8, 1, 25_508_000.0, math.radians(64.8), 0.7, 0.002),
}
"""Patterns of GPS, Galileo and GLONASS, by RINEX letter."""


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


def constellation(system: str, gps_time: float) -> tuple[tuple[str, ...], KeplerEphemeris]:
    """Return the satellites of a system.

    Args:
        system: RINEX letter, of :data:`PATTERNS`.
        gps_time: When the orbits are wanted to within some days, GPS seconds.

    Returns:
        Their names, such as G01, and their orbits, shape (S,); times of the orbits count from
        the beginning of the week of ``gps_time``.
    """
    pattern = PATTERNS[system]
    count = pattern.planes * pattern.per_plane
    number = np.arange(count)
    plane, place = number // pattern.per_plane, number % pattern.per_plane
    turn = 2.0 * math.pi
    # Spread over what real orbits have, always the same.
    eccentricity = pattern.eccentricity * np.mod(number * 0.618034, 1.0)
    perigee = turn * np.mod(number * 0.414214, 1.0)
    argument = turn * (place / pattern.per_plane + plane * pattern.phase / count)
    week = math.floor(gps_time / WEEK) * WEEK
    motion = math.sqrt(wgs84.GRAVITATIONAL_CONSTANT / pattern.semi_major_axis**3)
    node = pattern.first_node + turn * plane / pattern.planes - wgs84.EARTH_RATE * (week - EPOCH)
    elements = {
        "toe": np.full(count, gps_time - week),
        "toe_of_week": np.full(count, gps_time - week),
        "toc": np.full(count, gps_time - week),
        "sqrt_a": np.full(count, math.sqrt(pattern.semi_major_axis)),
        "eccentricity": eccentricity,
        "mean_anomaly": np.mod(argument - perigee + motion * (gps_time - EPOCH), turn),
        "perigee": perigee,
        "inclination": np.full(count, pattern.inclination),
        "node": np.mod(node, turn),
        "gravitation": np.full(count, wgs84.GRAVITATIONAL_CONSTANT),
        "earth_rate": np.full(count, wgs84.EARTH_RATE),
    }
    # Clocks are perfect, and orbits are not disturbed.
    none = np.zeros(count)
    values = (elements.get(name, none) for name in KeplerEphemeris._fields)
    names = tuple(f"{system}{n + 1:02d}" for n in number)
    return names, KeplerEphemeris(*(torch.tensor(v, dtype=torch.float64) for v in values))


def signals(
    orbits: KeplerEphemeris, seconds: Array, place: tuple[Array, Array, Array], v_l: Array
) -> Signals:
    """Return what an antenna takes in from satellites.

    The time of sending is found from the distance by iteration; the rate of the distance counts
    that the time of sending moves less than that of reception where the satellite recedes.

    Args:
        orbits: Orbits, shape (S,).
        seconds: Times of reception, GPS seconds of the orbits' week, shape (M,).
        place: Latitude (rad), longitude (rad) and height (m) of the antenna, shape (M,) each.
        v_l: Its velocity, east, north, up, m/s, shape (M, 3).
    """
    lat, lon, height = (torch.from_numpy(np.ascontiguousarray(a)) for a in place)
    antenna = frames.ecef_from_geodetic(lat, lon, height)[:, None, :]
    c_le = frames.enu_from_ecef_matrix(lat, lon)
    moving = torch.einsum("mij,mi->mj", c_le, torch.from_numpy(v_l))[:, None, :]
    at = torch.from_numpy(seconds)[:, None]
    travel = torch.full((at.shape[0], orbits.toe.shape[0]), 0.075, dtype=torch.float64)
    for _ in range(_PASSES):
        state = kepler_state(orbits, at - travel)
        here = in_axes_of_reception(state.position, travel)
        travel = torch.linalg.vector_norm(here - antenna, dim=-1) / SPEED_OF_LIGHT
    seen = sight(lat, lon, height, here)
    unit = (here - antenna) / seen.distance[..., None]
    sent = in_axes_of_reception(state.velocity, travel)
    # d(here)/dt = sent (1 − τ') − (ω × here) τ', and τ' = rate / c.
    drag = (unit * (sent + _earth_turn(here))).sum(-1) / SPEED_OF_LIGHT
    rate = (unit * (sent - moving)).sum(-1) / (1.0 + drag)
    found = (state.position, state.velocity, seen.distance, rate, seen.elevation, seen.azimuth)
    return Signals(*(a.numpy() for a in found))


def _earth_turn(position: Tensor) -> Tensor:
    x, y, z = position.unbind(-1)
    return wgs84.EARTH_RATE * torch.stack((-y, x, torch.zeros_like(z)), dim=-1)
