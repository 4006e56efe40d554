"""Signals that arrive by reflection alone: a detour, a weaker signal, a wrong Doppler.

A satellite behind a roof may be received off the house across; any other loses its direct
signal now and then for some seconds, the lower the more often.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navlearn.logs.synthetic.draws import Array, generator
from navlearn.logs.synthetic.satellite_options import SatelliteOptions

Flags = NDArray[np.bool_]


class Reflections(NamedTuple):
    """Reflections of S satellites at M receptions, shape (M, S) each.

    Attributes:
        present: Whether the signal arrives by reflection alone.
        lost: Whether a hidden satellite is not received at all.
        detour: How much longer its way is, m.
        loss: How much weaker it is, dB.
        rate_share: Error of its range rate as a share of the car's speed.
    """

    present: Flags
    lost: Flags
    detour: Array
    loss: Array
    rate_share: Array


def reflections(
    names: tuple[str, ...],
    elevation: Array,
    behind: Flags,
    dt: float,
    *,
    options: SatelliteOptions,
    seed: int,
) -> Reflections:
    """Return which signals are reflected.

    Args:
        names: Satellites S.
        elevation: Their elevation, rad, shape (M, S).
        behind: Whether a roof hides them, shape (M, S).
        dt: Time between receptions, s.
        options: How often, how long, how far.
        seed: Seed of the simulation.
    """
    parts = [
        _of_one(elevation[:, i], behind[:, i], dt, options, seed, name)
        for i, name in enumerate(names)
    ]
    return Reflections(*(np.stack(columns, axis=1) for columns in zip(*parts, strict=True)))


def _of_one(
    elevation: Array, behind: Flags, dt: float, options: SatelliteOptions, seed: int, name: str
) -> Reflections:
    count = elevation.size
    one = Reflections(
        np.zeros(count, dtype=np.bool_), behind.copy(), *(np.zeros(count) for _ in range(3))
    )
    rng = generator(seed, f"ranges/reflections/{name}")
    for begin, end in runs(behind):
        if rng.random() < options.canyon_reflected:
            _reflect(one, slice(begin, end), options, rng)
    rng = generator(seed, f"ranges/episodes/{name}")
    often = options.reflections_per_hour * dt / 3600.0 * np.cos(elevation) ** 2
    shortest, longest = options.reflection_shortest, options.reflection_longest
    for start in np.flatnonzero(rng.random(count) < often).tolist():
        span = math.exp(rng.uniform(math.log(shortest), math.log(longest)))
        part = slice(start, start + max(1, round(span / dt)))
        # A hidden satellite is what the street makes of it.
        if not behind[part].any():
            _reflect(one, part, options, rng)
    return one


def _reflect(
    one: Reflections, part: slice, options: SatelliteOptions, rng: np.random.Generator
) -> None:
    detour, loss, rate = rng.exponential(options.reflection), rng.standard_normal(), rng.normal()
    one.present[part] = True
    one.lost[part] = False
    one.detour[part] = detour
    one.loss[part] = max(options.reflection_loss * (1.0 + 0.25 * loss), 0.0)
    one.rate_share[part] = options.reflection_rate * rate


def runs(flags: Flags) -> list[tuple[int, int]]:
    """Return where flags are set: first place and the one after the last, of every run.

    Args:
        flags: Flags, shape (M,).
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
