"""Orbits and clocks of satellites that broadcast Keplerian elements.

Source: [ISGPS200] table 20-IV and §20.3.3.3.3.1; the same algorithm in [GalileoSIS] §5.1.1 and
[BeiDouB1I] §5.2.4.12, whose geostationary satellites are told in axes tilted by 5 degrees.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.gnss import signals
from navlearn.gnss.ephemeris import KeplerEphemeris, SatelliteState
from navlearn.gnss.gnss_time import half_week


class _Orbit(NamedTuple):
    """In the plane of the orbit: quantities and their rates per second."""

    radius: Tensor
    radius_rate: Tensor
    latitude: Tensor
    latitude_rate: Tensor
    inclination: Tensor
    inclination_rate: Tensor


def eccentric_anomaly(mean_anomaly: Tensor, eccentricity: Tensor) -> Tensor:
    """Return E of M = E − e sin E.

    Six Newton steps: to rounding for eccentricities to 0.3, and with right derivatives.

    Args:
        mean_anomaly: M, rad, shape (...).
        eccentricity: e, shape (...).

    Returns:
        Eccentric anomaly, rad, shape (...).
    """
    anomaly = mean_anomaly + eccentricity * torch.sin(mean_anomaly)
    for _ in range(6):
        short = anomaly - eccentricity * torch.sin(anomaly) - mean_anomaly
        anomaly = anomaly - short / (1.0 - eccentricity * torch.cos(anomaly))
    return anomaly


def kepler_state(ephemeris: KeplerEphemeris, gps_seconds: Tensor) -> SatelliteState:
    """Return position, velocity and clock of satellites when they send.

    Velocity and clock rate are the exact derivatives of position and clock.

    Args:
        ephemeris: Broadcast elements, shape that broadcasts with ``gps_seconds``.
        gps_seconds: Time of sending by a perfect clock (the time that the satellite stamps, less
            its clock), GPS seconds of the same origin as the ephemeris, shape (...).
    """
    since = half_week(gps_seconds - ephemeris.toe)
    a = ephemeris.sqrt_a**2
    motion = torch.sqrt(ephemeris.gravitation / a**3) + ephemeris.mean_motion_difference
    mean = torch.remainder(ephemeris.mean_anomaly + motion * since, 2.0 * math.pi)
    anomaly = eccentric_anomaly(mean, ephemeris.eccentricity)
    anomaly_rate = motion / (1.0 - ephemeris.eccentricity * torch.cos(anomaly))
    orbit = _in_plane(ephemeris, since, anomaly, anomaly_rate)
    position, velocity = _earth_fixed(ephemeris, since, orbit)
    clock, clock_rate = _clock(ephemeris, gps_seconds, anomaly, anomaly_rate)
    return SatelliteState(position, velocity, clock, clock_rate)


def _in_plane(
    ephemeris: KeplerEphemeris, since: Tensor, anomaly: Tensor, anomaly_rate: Tensor
) -> _Orbit:
    """Return radius, argument of latitude and inclination with their harmonics, and rates."""
    e, a = ephemeris.eccentricity, ephemeris.sqrt_a**2
    s, c = torch.sin(anomaly), torch.cos(anomaly)
    root = torch.sqrt(1.0 - e * e)
    phi = torch.atan2(root * s, c - e) + ephemeris.perigee
    phi_rate = root * anomaly_rate / (1.0 - e * c)
    s2, c2 = torch.sin(2.0 * phi), torch.cos(2.0 * phi)
    turn = 2.0 * phi_rate
    return _Orbit(
        a * (1.0 - e * c) + ephemeris.crs * s2 + ephemeris.crc * c2,
        a * e * s * anomaly_rate + turn * (ephemeris.crs * c2 - ephemeris.crc * s2),
        phi + ephemeris.cus * s2 + ephemeris.cuc * c2,
        phi_rate + turn * (ephemeris.cus * c2 - ephemeris.cuc * s2),
        ephemeris.inclination
        + ephemeris.inclination_rate * since
        + ephemeris.cis * s2
        + ephemeris.cic * c2,
        ephemeris.inclination_rate + turn * (ephemeris.cis * c2 - ephemeris.cic * s2),
    )


def _earth_fixed(ephemeris: KeplerEphemeris, since: Tensor, orbit: _Orbit) -> tuple[Tensor, Tensor]:
    """Return position and velocity, turned out of the plane of the orbit."""
    # tilted axes stand still in space while the orbit is turned into them
    turning = ephemeris.earth_rate * (1.0 - ephemeris.tilted)
    node_rate = ephemeris.node_rate - turning
    node = ephemeris.node + node_rate * since - ephemeris.earth_rate * ephemeris.toe_of_week
    sn, cn = torch.sin(node), torch.cos(node)
    si, ci = torch.sin(orbit.inclination), torch.cos(orbit.inclination)
    su, cu = torch.sin(orbit.latitude), torch.cos(orbit.latitude)
    along, across = orbit.radius * cu, orbit.radius * su
    along_rate = orbit.radius_rate * cu - across * orbit.latitude_rate
    across_rate = orbit.radius_rate * su + along * orbit.latitude_rate
    level = across * ci
    level_rate = across_rate * ci - across * si * orbit.inclination_rate
    x, y, z = along * cn - level * sn, along * sn + level * cn, across * si
    v_x = along_rate * cn - level_rate * sn - y * node_rate
    v_y = along_rate * sn + level_rate * cn + x * node_rate
    v_z = across_rate * si + level * orbit.inclination_rate
    return _out_of_tilted_axes(ephemeris, since, (x, y, z), (v_x, v_y, v_z))


def _out_of_tilted_axes(
    ephemeris: KeplerEphemeris,
    since: Tensor,
    position: tuple[Tensor, Tensor, Tensor],
    velocity: tuple[Tensor, Tensor, Tensor],
) -> tuple[Tensor, Tensor]:
    """Return vectors turned by −5° about x and with the Earth about z; others stay."""
    tilt = math.radians(-5.0) * ephemeris.tilted
    turned = ephemeris.earth_rate * ephemeris.tilted * since
    st, ct, sz, cz = torch.sin(tilt), torch.cos(tilt), torch.sin(turned), torch.cos(turned)
    (x, y, z), (v_x, v_y, v_z) = position, velocity
    y, z = ct * y + st * z, ct * z - st * y
    v_y, v_z = ct * v_y + st * v_z, ct * v_z - st * v_y
    rate = ephemeris.earth_rate * ephemeris.tilted
    x, y = cz * x + sz * y, cz * y - sz * x
    v_x, v_y = cz * v_x + sz * v_y + rate * y, cz * v_y - sz * v_x - rate * x
    return torch.stack((x, y, z), dim=-1), torch.stack((v_x, v_y, v_z), dim=-1)


def _clock(
    ephemeris: KeplerEphemeris, gps_seconds: Tensor, anomaly: Tensor, anomaly_rate: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the clock with relativity and group delay, m, and its rate, m/s."""
    since = half_week(gps_seconds - ephemeris.toc)
    light = signals.SPEED_OF_LIGHT
    swing = -2.0 / light**2 * torch.sqrt(ephemeris.gravitation)
    swing = swing * ephemeris.eccentricity * ephemeris.sqrt_a
    drift = ephemeris.clock_drift + ephemeris.clock_drift_rate * since
    clock = ephemeris.clock_bias + drift * since - ephemeris.group_delay
    clock_rate = drift + ephemeris.clock_drift_rate * since
    clock = clock + swing * torch.sin(anomaly)
    clock_rate = clock_rate + swing * torch.cos(anomaly) * anomaly_rate
    return light * clock, light * clock_rate
