"""Which satellites a rule chooses, and how much their ranges tell of the plane."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.outages.visible import PRIOR, RANGE, chosen, information


def direction(elevation: float, azimuth: float) -> np.ndarray:
    e, a = math.radians(elevation), math.radians(azimuth)
    return np.array([math.cos(e) * math.sin(a), math.cos(e) * math.cos(a), math.sin(e)])


units = st.tuples(st.floats(5.0, 89.0), st.floats(0.0, 359.0)).map(lambda sky: direction(*sky))


@settings(max_examples=60, deadline=None)
@given(st.lists(units, min_size=1, max_size=6).map(np.array))
def test_information_is_that_of_a_weighted_least_squares(unit: np.ndarray) -> None:
    # The second way: the inverse of the plane's block of the covariance of the whole.
    rows = np.concatenate((-unit, np.ones((len(unit), 1))), axis=1)
    normal = rows.T @ rows / RANGE**2 + np.diag(np.array(PRIOR) ** -2.0)
    plane = np.linalg.inv(normal)[:2, :2]
    assert information(unit) == pytest.approx(1.0 / np.linalg.det(plane), rel=1e-8)
    # More ranges never tell less, and turning the sky changes nothing.
    assert information(unit) >= information(unit[:-1]) * (1.0 - 1e-9)
    c, s = math.cos(0.7), math.sin(0.7)
    turned = unit @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert information(turned) == pytest.approx(information(unit), rel=1e-8)


@settings(max_examples=25, deadline=None)
@given(st.lists(units, min_size=3, max_size=8).map(np.array), st.integers(1, 3))
def test_no_choice_tells_more_than_the_best_or_less_than_the_worst(
    unit: np.ndarray, count: int
) -> None:
    names = [f"G{k:02d}" for k in range(len(unit))]
    told = {
        tuple(names[k] for k in members): information(unit[list(members)])
        for members in combinations(range(len(unit)), count)
    }
    best = chosen("best_geometry", count, names, unit)
    worst = chosen("worst_geometry", count, names, unit)
    assert told[best] == max(told.values())
    assert told[worst] == min(told.values())


def test_of_very_many_satellites_they_are_taken_one_after_another() -> None:
    rng = np.random.default_rng(0)
    sky = zip(rng.uniform(10.0, 85.0, 40), rng.uniform(0.0, 360.0, 40), strict=True)
    unit = np.array([direction(e, a) for e, a in sky])
    names = [f"G{k:02d}" for k in range(40)]
    found = chosen("best_geometry", 5, names, unit)  # 658 008 subsets
    taken = information(unit[[names.index(name) for name in found]])
    some = [information(unit[rng.permutation(40)[:5]]) for _ in range(2000)]
    assert len(set(found)) == 5
    assert taken > max(some)
