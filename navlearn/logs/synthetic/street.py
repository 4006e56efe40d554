"""Streets between houses: which satellites the roofs hide.

The way alternates between streets with houses and open ground. A street runs where the car
heads; across it the roofs stand at the elevation of their side, along it the view is free:
tan(mask) = tan(roof) |sin(bearing)|, the bearing counted from the car's azimuth.
"""

import math

import numpy as np
from numpy.typing import NDArray

from navlearn.logs.synthetic.draws import Array, generator
from navlearn.logs.synthetic.satellite_options import SatelliteOptions

_LOWEST_ROOF, _HIGHEST_ROOF = math.radians(2.0), math.radians(85.0)


def roofs(way: Array, *, options: SatelliteOptions, seed: int) -> Array:
    """Return the elevation of the roofs to the left and to the right of the car.

    Args:
        way: Distance driven since the start, m, not decreasing, shape (M,).
        options: Share, length and heights of streets.
        seed: Seed of the simulation.

    Returns:
        Elevations, rad, zero on open ground, shape (M, 2).
    """
    share = options.canyon_share
    if share <= 0.0 or way.size == 0:
        return np.zeros((way.size, 2))
    rng = generator(seed, "ranges/streets")
    inside = bool(rng.random() < share)
    ends, heights, end = list[float](), list[Array](), 0.0
    while end <= way[-1]:
        length = options.canyon_length * (1.0 if inside else (1.0 - share) / share)
        end += max(rng.exponential(length), 0.1 * length) if length > 0.0 else 0.0
        drawn = rng.normal(options.canyon_deg, options.canyon_spread_deg, 2)
        roof = np.clip(np.radians(drawn), _LOWEST_ROOF, _HIGHEST_ROOF)
        ends.append(end)
        heights.append(roof if inside else np.zeros(2))
        inside = not inside
    return np.stack(heights)[np.searchsorted(np.array(ends), way, side="right")]


def hidden(roof: Array, heading: Array, azimuth: Array, elevation: Array) -> NDArray[np.bool_]:
    """Return which satellites stand behind a roof.

    Args:
        roof: Elevation of the roofs to the left and to the right, rad, shape (M, 2).
        heading: Azimuth of the car, rad, shape (M,).
        azimuth: Azimuth of the satellites, rad, shape (M, S).
        elevation: Their elevation, rad, shape (M, S).

    Returns:
        Whether each is hidden, shape (M, S).
    """
    across = np.sin(azimuth - heading[:, None])
    side = np.where(across > 0.0, roof[:, 1:], roof[:, :1])
    return np.asarray(np.tan(elevation) < np.tan(side) * np.abs(across), dtype=np.bool_)
