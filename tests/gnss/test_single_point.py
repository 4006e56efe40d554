"""Single-point positions against the geometry that made the ranges."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from navlearn.frames import enu_between
from navlearn.gnss.single_point import single_point


@pytest.mark.parametrize("systems", [1, 2, 3])
def test_exact_without_noise(make_sky: Callable[..., Any], systems: int) -> None:
    sky = make_sky(satellites=10, systems=systems)
    found = single_point(sky.ranges)
    assert found.ok.all()
    for part in enu_between(found.lat, found.lon, found.height, sky.lat, sky.lon, sky.height):
        torch.testing.assert_close(part, torch.zeros_like(part), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(found.clock, sky.clock, atol=1e-6, rtol=0.0)
    assert (found.degrees == 10 - 3 - systems).all()
