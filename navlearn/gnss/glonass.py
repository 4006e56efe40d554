"""Orbits and clocks of GLONASS satellites, which broadcast a state to integrate.

Source: [GLONASSICD] §A.3.1.2, simplified algorithm, axes PZ-90; fourth-order Runge-Kutta.
PZ-90.11 and WGS 84 differ by centimetres.
"""

import math

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.gnss import signals
from navlearn.gnss.ephemeris import GlonassEphemeris, SatelliteState
from navlearn.gnss.gnss_time import half_week

GRAVITATION: float = 3.986004418e14
"""GM of PZ-90, m³/s²."""

EQUATORIAL_RADIUS: float = 6378136.0
"""Semi-major axis of PZ-90, m."""

OBLATENESS: float = 1.08262575e-3
"""J₂ of PZ-90."""

EARTH_RATE: float = 7.292115e-5
"""Rotation rate of the Earth, rad/s."""


def glonass_acceleration(position: Tensor, velocity: Tensor, by_others: Tensor) -> Tensor:
    """Return the acceleration against the turning Earth.

    [GLONASSICD] §A.3.1.2: gravity with J₂, centrifugal and Coriolis force, Sun and Moon.

    Args:
        position: Position, m, shape (..., 3).
        velocity: Velocity against the Earth, m/s, shape (..., 3).
        by_others: Acceleration by Sun and Moon, m/s², shape (..., 3).

    Returns:
        Acceleration, m/s², shape (..., 3).
    """
    x, y, z = position.unbind(-1)
    v_x, v_y, _ = velocity.unbind(-1)
    square = (position * position).sum(-1)
    pull = GRAVITATION / (square * torch.sqrt(square))
    bulge = 1.5 * OBLATENESS * pull * EQUATORIAL_RADIUS**2 / square
    polar = 5.0 * z * z / square
    level = bulge * (polar - 1.0) - pull + EARTH_RATE**2
    gravity = torch.stack(
        (
            level * x + 2.0 * EARTH_RATE * v_y,
            level * y - 2.0 * EARTH_RATE * v_x,
            (bulge * (polar - 3.0) - pull) * z,
        ),
        dim=-1,
    )
    return gravity + by_others


def glonass_state(
    ephemeris: GlonassEphemeris, gps_seconds: Tensor, *, longest_step: float = 30.0
) -> SatelliteState:
    """Return position, velocity and clock of GLONASS satellites when they send.

    All satellites take the same number of steps, so that none is longer than told.

    Args:
        ephemeris: Broadcast states, shape that broadcasts with ``gps_seconds``.
        gps_seconds: Time of sending by a perfect clock, GPS seconds of the same origin as the
            ephemeris, shape (...).
        longest_step: Longest step of the integration, s; with half a minute half an hour keeps a
            tenth of a millimetre.

    Raises:
        ShapeError: The longest step is not positive, or a time is not finite.
    """
    if not longest_step > 0.0:
        raise ShapeError(f"longest_step is {longest_step} s; expected a positive number")
    since = half_week(gps_seconds - ephemeris.toe)
    furthest = float(since.detach().abs().max()) if since.numel() else 0.0
    if not math.isfinite(furthest):
        raise ShapeError("gps_seconds or toe holds what is no finite time; leave such rows out")
    steps = max(1, math.ceil(furthest / longest_step))
    step = (since / steps).unsqueeze(-1)
    position = ephemeris.position + torch.zeros_like(step)
    velocity = ephemeris.velocity + torch.zeros_like(step)
    for _ in range(steps):
        position, velocity = _runge_kutta(position, velocity, ephemeris.acceleration, step)
    light = signals.SPEED_OF_LIGHT
    clock = ephemeris.clock_bias + ephemeris.clock_drift * since
    return SatelliteState(
        position, velocity, light * clock, (light * ephemeris.clock_drift).expand_as(clock)
    )


def _runge_kutta(
    position: Tensor, velocity: Tensor, by_others: Tensor, step: Tensor
) -> tuple[Tensor, Tensor]:
    """Return position and velocity one step later."""
    half = 0.5 * step
    a_1 = glonass_acceleration(position, velocity, by_others)
    v_2 = velocity + half * a_1
    a_2 = glonass_acceleration(position + half * velocity, v_2, by_others)
    v_3 = velocity + half * a_2
    a_3 = glonass_acceleration(position + half * v_2, v_3, by_others)
    v_4 = velocity + step * a_3
    a_4 = glonass_acceleration(position + step * v_3, v_4, by_others)
    sixth = step / 6.0
    return (
        position + sixth * (velocity + 2.0 * (v_2 + v_3) + v_4),
        velocity + sixth * (a_1 + 2.0 * (a_2 + a_3) + a_4),
    )
