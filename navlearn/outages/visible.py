"""Chooses the satellites that stay through an outage, by geometry alone.

How much k < 4 ranges tell of the plane cannot be said by a dilution of precision, which needs
four. What stands here is the information that is left of the plane beside a prior as an outage
leaves it, so that one formula holds for every number of satellites: [Groves2013] §9.4.2 for the
rows, a Schur complement for what is eliminated.
"""

from collections.abc import Sequence
from itertools import combinations
from math import comb

import numpy as np

from navlearn.outages.track import Array

RANGE = 5.0
"""Standard deviation of a range, m, ..."""

PRIOR = (20.0, 20.0, 10.0, 20.0)
"""... and of what is known without ranges: east, north, up, clock, m, as after a minute."""

MOST_SUBSETS = 20_000
"""Up to so many subsets are all looked at; of more, satellites are taken one after another."""


def information(unit: Array) -> float:
    """Return how much ranges tell of the plane, the larger the more.

    With rows a = (−unit, 1) of the ranges to east, north, up and the clock, S the sum of a aᵀ /
    ``RANGE``² over the satellites and of the inverse prior, it is det(S_pp − S_px S_xx⁻¹ S_xp): p
    is the plane, x height and clock. The offsets between systems count as known.

    Args:
        unit: Unit vectors from car to satellites, east, north, up, shape (k, 3).

    Returns:
        Determinant of the information of the plane, 1/m⁴.
    """
    rows = np.concatenate((-unit, np.ones((len(unit), 1))), axis=1)
    whole = rows.T @ rows / RANGE**2 + np.diag(np.array(PRIOR) ** -2.0)
    cross = whole[:2, 2:]
    plane = whole[:2, :2] - cross @ np.linalg.solve(whole[2:, 2:], cross.T)
    return float(np.linalg.det(plane))


def chosen(
    rule: str,
    count: int,
    names: Sequence[str],
    unit: Array,
    *,
    listed: Sequence[str] = (),
    seed: Sequence[int] = (0,),
) -> tuple[str, ...]:
    """Return the satellites that stay.

    All rules but the two geometries are nested: fewer are a part of more.

    Args:
        rule: One of :data:`navlearn.outages.schedule.VISIBLE`.
        count: How many stay, at most as many as there are names.
        names: Satellites that could stay, sorted, n of them.
        unit: Unit vectors from car to them, east, north, up, shape (n, 3).
        listed: Names for ``listed``, in order; those beyond ``count`` are not looked at.
        seed: Of the draw of ``random``.

    Returns:
        Their names, sorted.
    """
    if rule == "listed":
        return tuple(sorted(listed[:count]))
    if rule == "random":
        order = np.random.default_rng(list(seed)).permutation(len(names))
    elif rule == "highest":
        order = np.argsort(-unit[:, 2], kind="stable")
    else:
        order = np.array(_by_geometry(unit, count, best=rule == "best_geometry"), dtype=np.int64)
    return tuple(sorted(names[int(k)] for k in order[:count]))


def _by_geometry(unit: Array, count: int, *, best: bool) -> tuple[int, ...]:
    sign = 1.0 if best else -1.0

    def worth(members: tuple[int, ...]) -> float:
        return sign * information(unit[list(members)])

    if comb(len(unit), count) <= MOST_SUBSETS:
        return max(combinations(range(len(unit)), count), key=worth)
    members: tuple[int, ...] = ()
    for _ in range(count):
        others = (k for k in range(len(unit)) if k not in members)
        members = max(((*members, k) for k in others), key=worth)
    return members
