"""Strapdown beside pyins, written by others in other frames; ten minutes where slow tests run."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from beside_pyins import frames
from pyins_strapdown import greatest, solutions_of

pytest.importorskip(
    "pyins",
    reason="pyins is installed from github.com/nmayorov/pyins: "
    "pip install git+https://github.com/nmayorov/pyins",
)
# pandas tells pyins of what it will drop
pytestmark = pytest.mark.filterwarnings("ignore")


OURS = ("local level", "Earth-centred")


@pytest.fixture(
    scope="module", params=[100, pytest.param(600, marks=pytest.mark.slow)], ids="{} s".format
)
def solutions(request):
    return solutions_of(frames.drive(request.param, 11).log)


@pytest.mark.parametrize("name", OURS)
def test_comes_to_the_truth(solutions, name):
    flat, up, velocity, angle = greatest(solutions[name], solutions["truth"])
    assert flat < 2e-3
    assert up < 1e-4
    assert velocity < 1e-5
    assert angle < 1e-8


@pytest.mark.parametrize("name", OURS)
def test_agrees_with_pyins_where_gravity_is_the_same(solutions, name):
    flat, up, velocity, angle = greatest(solutions[name], solutions["pyins, same gravity"])
    assert flat < 0.05
    assert up < 0.01
    assert velocity < 2e-4
    assert angle < 1e-8


@pytest.mark.parametrize("name", OURS)
def test_stands_no_further_from_the_truth_than_pyins(solutions, name):
    ours = greatest(solutions[name], solutions["truth"])
    theirs = greatest(solutions["pyins, same gravity"], solutions["truth"])
    assert all(a < b for a, b in zip(ours, theirs, strict=True))


def test_simpler_gravity_of_pyins_lifts_or_drops_the_car(solutions):
    place, _, _ = frames.difference(solutions["pyins"], solutions["pyins, same gravity"])
    # half of 1e-6 m/s² less, times the square of the time
    assert 0.2 < np.abs(place[-1, 2]) / (0.5e-6 * len(place) ** 2 / 1e4) < 2.0
    assert np.abs(place[:, :2]).max() < 0.01


def test_both_forms_agree(solutions):
    flat, up, velocity, angle = greatest(solutions["local level"], solutions["Earth-centred"])
    assert flat < 1e-4
    assert up < 1e-4
    assert velocity < 1e-6
    assert angle < 1e-10
