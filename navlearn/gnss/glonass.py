"""Orbits and clocks of GLONASS satellites, which broadcast a state to integrate.

Source: [GLONASSICD] §A.3.1.2, simplified algorithm, axes PZ-90; fourth-order Runge-Kutta.
PZ-90.11 and WGS 84 differ by centimetres.
"""

import math

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.gnss import pz90, signals
from navlearn.gnss.ephemeris import GlonassEphemeris, SatelliteState
from navlearn.gnss.gnss_time import half_week


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
    return _acceleration(
        position.movedim(-1, 0), velocity.movedim(-1, 0), by_others.movedim(-1, 0)
    ).movedim(0, -1)


def glonass_state(
    ephemeris: GlonassEphemeris, gps_seconds: Tensor, longest_step: float = 60.0
) -> SatelliteState:
    """Return position, velocity and clock of GLONASS satellites when they send.

    All satellites take the same number of steps, so that none is longer than told.

    Args:
        ephemeris: Broadcast states, shape that broadcasts with ``gps_seconds``.
        gps_seconds: Time of sending by a perfect clock, GPS seconds of the same origin as the
            ephemeris, shape (...).
        longest_step: Longest step of the integration, s; a minute keeps 1.3 mm in half an hour.

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
    step = since / steps
    # axes first: each component lies together in memory, twice as fast
    spread = torch.zeros_like(step).unsqueeze(-1)
    position = (ephemeris.position + spread).movedim(-1, 0).contiguous()
    velocity = (ephemeris.velocity + spread).movedim(-1, 0).contiguous()
    by_others = (ephemeris.acceleration + spread).movedim(-1, 0).contiguous()
    for _ in range(steps):
        position, velocity = _runge_kutta(position, velocity, by_others, step)
    position, velocity = position.movedim(0, -1), velocity.movedim(0, -1)
    light = signals.SPEED_OF_LIGHT
    clock = ephemeris.clock_bias + ephemeris.clock_drift * since
    return SatelliteState(
        position, velocity, light * clock, (light * ephemeris.clock_drift).expand_as(clock)
    )


def _acceleration(position: Tensor, velocity: Tensor, by_others: Tensor) -> Tensor:
    """Return :func:`glonass_acceleration` of vectors with their axis first."""
    square = (position * position).sum(0)
    pull = pz90.GRAVITATIONAL_CONSTANT / (square * torch.sqrt(square))
    bulge = 1.5 * pz90.OBLATENESS * pz90.SEMI_MAJOR_AXIS**2 * pull / square
    polar = 5.0 * position[2] ** 2 / square
    level = bulge * (polar - 1.0) - pull + pz90.EARTH_RATE**2
    own = torch.stack(
        (
            level * position[0] + 2.0 * pz90.EARTH_RATE * velocity[1],
            level * position[1] - 2.0 * pz90.EARTH_RATE * velocity[0],
            (bulge * (polar - 3.0) - pull) * position[2],
        )
    )
    return own + by_others


def _runge_kutta(
    position: Tensor, velocity: Tensor, by_others: Tensor, step: Tensor
) -> tuple[Tensor, Tensor]:
    """Return position and velocity one step later."""
    half = 0.5 * step
    a_1 = _acceleration(position, velocity, by_others)
    v_2 = velocity + half * a_1
    a_2 = _acceleration(position + half * velocity, v_2, by_others)
    v_3 = velocity + half * a_2
    a_3 = _acceleration(position + half * v_2, v_3, by_others)
    v_4 = velocity + step * a_3
    a_4 = _acceleration(position + step * v_3, v_4, by_others)
    sixth = step / 6.0
    return (
        position + sixth * (velocity + 2.0 * (v_2 + v_3) + v_4),
        velocity + sixth * (a_1 + 2.0 * (a_2 + a_3) + a_4),
    )
