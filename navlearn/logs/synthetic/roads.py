"""Kinds of road, and routes drawn from them: curvature, speed limit and stops over distance."""

import math
from dataclasses import dataclass

import numpy as np

from navlearn.logs.synthetic.draws import Array, smooth_noise

CELL = 1.0
"""Length of a route cell, m."""

STEEPEST = 0.08
"""Limit of the slope, rad."""

LEVELLING = 150.0
"""Way over which a section's slope fades in and out, m."""

Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Road:
    """What one kind of road is like; pairs are ranges that a leg draws from uniformly.

    Attributes:
        speed_kmh: Speed driven where nothing hinders, km/h.
        leg: Length between two junctions, m.
        turn: Share of the junctions at which the car turns.
        turn_deg: Angle of such a turn, deg.
        turn_radius: Mean radius of such a turn, m.
        stop: Share of the junctions at which the car waits.
        wait: How long it waits, s.
        bend_radius: Smallest radius of a bend within a leg, m.
        bend_deg: Angle of a bend, deg.
        bends_per_km: How many bends a kilometre has.
        slowdowns_per_km: How often traffic slows the car down.
        hill_length: Correlation length of the height, m.
        slope_percent: Standard deviation of the slope, %.
    """

    speed_kmh: Range
    leg: Range
    turn: float
    turn_deg: Range = (60.0, 115.0)
    turn_radius: Range = (9.0, 18.0)
    stop: float
    wait: Range = (4.0, 40.0)
    bend_radius: Range
    bend_deg: Range
    bends_per_km: float
    slowdowns_per_km: float
    hill_length: float
    slope_percent: float


ROADS: dict[str, Road] = {
    "town": Road(
        speed_kmh=(30.0, 50.0),
        leg=(70.0, 320.0),
        turn=0.55,
        stop=0.45,
        bend_radius=(60.0, 150.0),
        bend_deg=(8.0, 30.0),
        bends_per_km=1.5,
        slowdowns_per_km=2.0,
        hill_length=120.0,
        slope_percent=1.5,
    ),
    "suburb": Road(
        speed_kmh=(50.0, 70.0),
        leg=(250.0, 1000.0),
        turn=0.4,
        turn_radius=(12.0, 25.0),
        stop=0.3,
        wait=(3.0, 30.0),
        bend_radius=(90.0, 350.0),
        bend_deg=(10.0, 50.0),
        bends_per_km=1.5,
        slowdowns_per_km=0.7,
        hill_length=250.0,
        slope_percent=2.0,
    ),
    "motorway": Road(
        speed_kmh=(95.0, 125.0),
        leg=(2500.0, 5000.0),
        turn=0.0,
        stop=0.0,
        bend_radius=(700.0, 2500.0),
        bend_deg=(6.0, 35.0),
        bends_per_km=0.4,
        slowdowns_per_km=0.1,
        hill_length=600.0,
        slope_percent=1.5,
    ),
    "hills": Road(
        speed_kmh=(50.0, 80.0),
        leg=(500.0, 1800.0),
        turn=0.3,
        turn_radius=(15.0, 30.0),
        stop=0.1,
        wait=(3.0, 15.0),
        bend_radius=(30.0, 160.0),
        bend_deg=(20.0, 120.0),
        bends_per_km=4.0,
        slowdowns_per_km=0.3,
        hill_length=450.0,
        slope_percent=4.0,
    ),
}
"""Kinds of road by name."""


@dataclass(frozen=True, kw_only=True)
class Route:
    """A road ahead, cell by cell of :data:`CELL` metres.

    Attributes:
        curvature: Of each cell, 1/m, right turn positive.
        limit: Speed wished in each cell, m/s.
        pull: Acceleration that the driver uses, m/s².
        slope: Slope, rad, climbing positive.
        wait: Standstill at the start of a cell, s; zero nearly everywhere.
    """

    curvature: Array
    limit: Array
    pull: Array
    slope: Array
    wait: Array


def hump(rng: np.random.Generator, angle_deg: Range, radius: Range) -> Array:
    """Return the curvature of a turn that starts and ends smoothly, 1/m per cell.

    Args:
        rng: Generator to draw from.
        angle_deg: Range of the angle turned, deg; the side is drawn too.
        radius: Range of the mean radius, m.
    """
    angle = np.deg2rad(rng.uniform(*angle_deg)) * rng.choice((-1.0, 1.0))
    cells = max(4, round(abs(angle) * rng.uniform(*radius) / CELL))
    shape = np.sin(np.pi * (np.arange(cells) + 0.5) / cells) ** 2
    curvature: Array = shape * (angle / (shape.sum() * CELL))
    return curvature


def draw_leg(rng: np.random.Generator, road: Road) -> tuple[Array, Array, float]:
    """Return curvature and speed limit of the cells of one leg, and the wait at its end, s."""
    cells = round(rng.uniform(*road.leg) / CELL)
    curvature, limit = np.zeros(cells), np.full(cells, rng.uniform(*road.speed_kmh) / 3.6)
    for _ in range(rng.poisson(road.bends_per_km * cells * CELL / 1000.0)):
        bend = hump(rng, road.bend_deg, road.bend_radius)[: cells // 2]
        start = rng.integers(0, cells - bend.size + 1)
        if not curvature[start : start + bend.size].any():
            curvature[start : start + bend.size] = bend
    for _ in range(rng.poisson(road.slowdowns_per_km * cells * CELL / 1000.0)):
        start = rng.integers(0, cells)
        limit[start : start + round(rng.uniform(30.0, 150.0) / CELL)] *= rng.uniform(0.4, 0.8)
    if rng.random() < road.turn:
        turn = hump(rng, road.turn_deg, road.turn_radius)
        curvature = np.concatenate((curvature, turn))
        limit = np.concatenate((limit, np.full(turn.size, limit[-1])))
    wait = float(rng.uniform(*road.wait)) if rng.random() < road.stop else 0.0
    return curvature, limit, wait


def draw_section(rng: np.random.Generator, road: Road, duration: float) -> Route:
    """Return a route over one kind of road that takes at least about a given time.

    Args:
        rng: Generator to draw from.
        road: Kind of road.
        duration: Time wished, s.
    """
    curvature, limit, pull, wait = [], [], [], []
    elapsed = 0.0
    while elapsed < duration:
        bent, wished, pause = draw_leg(rng, road)
        held = np.zeros(bent.size)
        held[-1] = pause
        curvature.append(bent)
        limit.append(wished)
        pull.append(np.full(bent.size, rng.uniform(1.0, 2.0)))
        wait.append(held)
        elapsed += float(np.sum(CELL / wished)) + pause
    speed = np.concatenate(limit)
    # No driver holds a speed or a line: a few per cent, and lane keeping of radius 5 km.
    speed *= 1.0 + 0.03 * smooth_noise(rng, speed.size, 120.0)
    wander = smooth_noise(rng, speed.size, 40.0) / 5000.0
    grade = road.slope_percent / 100.0
    # The slope of smooth heights, scaled to unit variance: what goes up comes down again.
    heights = smooth_noise(rng, speed.size + 1, road.hill_length / CELL)
    steepness = np.diff(heights) * (math.sqrt(2.0) * road.hill_length / CELL)
    slope = STEEPEST * np.tanh(grade / STEEPEST * steepness)
    return Route(
        curvature=np.concatenate(curvature) + wander,
        limit=speed,
        pull=np.concatenate(pull),
        slope=slope,
        wait=np.concatenate(wait),
    )


def cut(route: Route, cells: int) -> Route:
    """Return the first cells of a route, its slope faded in and out."""
    ramp = (np.arange(cells) + 0.5) * (CELL / LEVELLING)
    fade = np.minimum(1.0, np.minimum(ramp, ramp[::-1]))
    return Route(
        curvature=route.curvature[:cells],
        limit=route.limit[:cells],
        pull=route.pull[:cells],
        slope=route.slope[:cells] * fade,
        wait=route.wait[:cells],
    )


def join(sections: list[Route]) -> Route:
    """Return the routes one after the other."""
    return Route(
        curvature=np.concatenate([s.curvature for s in sections]),
        limit=np.concatenate([s.limit for s in sections]),
        pull=np.concatenate([s.pull for s in sections]),
        slope=np.concatenate([s.slope for s in sections]),
        wait=np.concatenate([s.wait for s in sections]),
    )
