"""Streets: their share and length, and which satellites their roofs hide."""

import math
from dataclasses import replace

import numpy as np
import pytest

from navlearn.logs.synthetic.satellite_options import PRESETS
from navlearn.logs.synthetic.street import hidden, roofs

URBAN = replace(PRESETS["urban"], canyon_share=0.3, canyon_length=200.0, canyon_deg=40.0)
WAY = np.arange(0.0, 400_000.0, 10.0)


def test_share_length_and_heights_are_as_stated() -> None:
    found = roofs(WAY, options=URBAN, seed=3)
    inside = found[:, 0] > 0.0
    assert inside.mean() == pytest.approx(0.3, abs=0.03)
    streets = np.flatnonzero(np.diff(inside.astype(int)) == 1)
    # Each street has at least a tenth of the mean length.
    assert inside.sum() * 10.0 / streets.size == pytest.approx(201.0, rel=0.1)
    heights = np.degrees(found[streets + 1])
    assert heights.mean() == pytest.approx(40.0, abs=1.5)
    assert heights.std() == pytest.approx(12.0, rel=0.1)
    assert abs(np.corrcoef(heights.T)[0, 1]) < 0.15


def test_a_standing_car_stays_in_its_street() -> None:
    way = np.full(500, 37.0)
    found = roofs(way, options=URBAN, seed=3)
    assert (found == found[0]).all()


def test_open_ground_and_nothing_but_streets() -> None:
    assert not roofs(WAY, options=replace(URBAN, canyon_share=0.0), seed=1).any()
    assert (roofs(WAY, options=replace(URBAN, canyon_share=1.0), seed=1) > 0.0).all()
    assert roofs(np.zeros(0), options=URBAN, seed=1).shape == (0, 2)


def test_roofs_hide_across_and_leave_free_along() -> None:
    heading = np.radians([90.0])
    roof = np.radians([[60.0, 20.0]])

    def is_hidden(azimuth: float, elevation: float) -> bool:
        place = (np.radians([[azimuth]]), np.radians([[elevation]]))
        return bool(hidden(roof, heading, *place)[0, 0])

    # The car heads east: north is left of it, south right.
    assert is_hidden(0.0, 59.0)
    assert not is_hidden(0.0, 61.0)
    assert is_hidden(180.0, 19.0)
    assert not is_hidden(180.0, 21.0)
    for along in (90.0, 270.0):
        assert not is_hidden(along, 1.0)
    # A wall of height h at distance w: in a direction 30° off the street it is w / sin 30° away.
    mask = math.degrees(math.atan(math.tan(math.radians(60.0)) * 0.5))
    assert is_hidden(60.0, mask - 0.1)
    assert not is_hidden(60.0, mask + 0.1)
