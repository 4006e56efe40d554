"""Driving profiles: a route is drawn, and driven by a driver with limits.

The driver keeps the wished speed, the lateral acceleration in bends and turns, an acceleration
that fades with speed (constant power), and brakes in time: the usual forward and backward pass
over the squared speed along the route.
"""

import math

import numpy as np

from navlearn.errors import ConfigError
from navlearn.logs.synthetic.draws import Array, generator, smooth_noise
from navlearn.logs.synthetic.motion import (
    KNOT_DISTANCE,
    KNOT_INTERVAL,
    Motion,
    uniform_spline,
)
from navlearn.logs.synthetic.roads import CELL, ROADS, Route, cut, draw_section, join

PROFILES: dict[str, tuple[tuple[str, float], ...]] = {
    "town": (("town", 1.0),),
    "suburb": (("suburb", 1.0),),
    "motorway": (("motorway", 1.0),),
    "hills": (("hills", 1.0),),
    "commute": (
        ("town", 0.3),
        ("suburb", 0.2),
        ("motorway", 0.2),
        ("suburb", 0.1),
        ("town", 0.2),
    ),
    "mixed": (
        ("town", 0.25),
        ("suburb", 0.2),
        ("motorway", 0.25),
        ("hills", 0.1),
        ("suburb", 0.1),
        ("town", 0.1),
    ),
}
"""Sections of each profile: kind of road and share of the time."""

LATERAL_ACCELERATION = 2.4
"""Largest centripetal acceleration that the driver accepts, m/s²."""

BRAKING = 1.9
"""Deceleration of the driver, m/s²."""

POWER = 25.0
"""Power per mass: acceleration times speed stays below it, W/kg."""

CROSSFALL = 0.012
"""Standard deviation of the crossfall, rad."""


def speed_along(route: Route) -> Array:
    """Return the driven speed at the start of every cell and at the end of the last, m/s.

    Args:
        route: The road, n cells.

    Returns:
        Speed, shape (n + 1,); zero at the start and where the route waits.
    """
    cornering = np.sqrt(LATERAL_ACCELERATION / np.maximum(np.abs(route.curvature), 1e-9))
    top = np.minimum(route.limit, cornering)
    squared = np.append(np.minimum(top, np.append(top[0], top[:-1])), top[-1]) ** 2
    squared[:-1][route.wait > 0.0] = 0.0
    squared[0] = 0.0
    values, pull = squared.tolist(), route.pull.tolist()
    for k in range(len(values) - 1):
        gain = min(pull[k], POWER / max(math.sqrt(values[k]), 1.0))
        values[k + 1] = min(values[k + 1], values[k] + 2.0 * gain * CELL)
    for k in range(len(values) - 2, -1, -1):
        values[k] = min(values[k], values[k + 1] + 2.0 * BRAKING * CELL)
    return np.sqrt(np.asarray(values, dtype=np.float64))


def drive(route: Route, *, standstill: float) -> tuple[Array, Array, Array, Array]:
    """Return when the driver is where on the route.

    Args:
        route: The road.
        standstill: How long the car stands before it starts, s.

    Returns:
        Time (s), speed (m/s), distance (m) and azimuth turned (rad), shape (K,) each. Speed is
        linear in time between entries; a wait appears as two entries at one place.
    """
    speed = speed_along(route)
    wait = np.append(route.wait, 0.0)
    wait[0] = standstill
    travel = 2.0 * CELL / (speed[:-1] + speed[1:])
    arrival = np.concatenate(([0.0], np.cumsum(travel + wait[:-1])))
    distance = np.arange(speed.size, dtype=np.float64) * CELL
    azimuth = np.concatenate(([0.0], np.cumsum(route.curvature) * CELL))
    stops = np.flatnonzero(wait > 0.0)
    order = np.sort(np.concatenate((np.arange(speed.size), stops)))
    leaving = np.concatenate(([False], order[1:] == order[:-1]))
    time = arrival[order] + np.where(leaving, wait[order], 0.0)
    return time, speed[order], distance[order], azimuth[order]


def draw_route(rng: np.random.Generator, profile: str, duration: float) -> Route:
    """Return a route of a named profile that takes longer than a given time, s."""
    *early, last = PROFILES[profile]
    sections = []
    for name, share in early:
        section = draw_section(rng, ROADS[name], share * duration)
        time, _, distance, _ = drive(section, standstill=0.0)
        sections.append(
            cut(section, max(1, int(np.interp(share * duration, time, distance) / CELL)))
        )
    # The last section is drawn longer: the drive ends while it is still on the road.
    section = draw_section(rng, ROADS[last[0]], 1.2 * last[1] * duration + 60.0)
    return join([*sections, cut(section, section.limit.size)])


def draw_motion(profile: str, *, duration: float, seed: int, standstill: float = 30.0) -> Motion:
    """Return a seeded drive of a named profile.

    Args:
        profile: One of :data:`PROFILES`.
        duration: Length of the drive, s.
        seed: Seed of the simulation.
        standstill: How long the car stands before it starts, s.

    Raises:
        ConfigError: No such profile, or a duration that does not outlast the standstill.
    """
    if profile not in PROFILES:
        raise ConfigError(f"profile: found {profile!r}, expected one of {', '.join(PROFILES)}")
    if not math.isfinite(duration) or duration <= standstill or standstill < 0.0:
        raise ConfigError(
            f"duration: found {duration} s with a standstill of {standstill} s before the start; "
            "expected a finite duration longer than the standstill"
        )
    rng = generator(seed, "profile")
    route = draw_route(rng, profile, duration - standstill)
    time, speed, distance, azimuth = drive(route, standstill=standstill)
    heading = float(rng.uniform(-math.pi, math.pi))
    end = float(np.interp(duration, time, distance)) + 100.0
    tilt = CROSSFALL * smooth_noise(rng, route.slope.size, 80.0)
    along = (np.arange(route.slope.size) + 0.5) * CELL
    return Motion(
        duration=duration,
        speed=uniform_spline(lambda t: np.interp(t, time, speed), duration, KNOT_INTERVAL),
        azimuth=uniform_spline(
            lambda t: heading + np.interp(t, time, azimuth), duration, KNOT_INTERVAL
        ),
        slope=uniform_spline(lambda s: np.interp(s, along, route.slope), end, KNOT_DISTANCE),
        crossfall=uniform_spline(lambda s: np.interp(s, along, tilt), end, KNOT_DISTANCE),
        description=f"profile {profile}, {duration:g} s, seed {seed}",
    )
