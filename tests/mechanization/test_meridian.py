"""Places, gravity and local level in the meridian frame against the plain formulas."""

import math

import pytest
import torch

from navlearn import attitude, earth, frames
from navlearn.mechanization.local_level import geodetic_change, gravity_on_the_way
from navlearn.mechanization.meridian import (
    gravity_at,
    level_to_meridian,
    place_in_meridian,
    plumb_line,
)


def _places() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    lat = torch.tensor((-89.5, -60.0, -12.0, 0.0, 44.2, 71.0, 89.0)).double().deg2rad()
    lon = torch.tensor((-3.0, 1.7, 0.0, -1.3, 3.1, 0.4, 2.2), dtype=torch.float64)
    height = torch.tensor((-400.0, 0.0, 3000.0, 100.0, 9000.0, 60.0, 10.0), dtype=torch.float64)
    return lat, lon, height


def test_plumb_line_returns_the_place():
    lat, lon, height = _places()
    line = plumb_line(*frames.ecef_from_geodetic(lat, lon, height).unbind(-1))
    torch.testing.assert_close(line.sin_lat, torch.sin(lat), rtol=0, atol=1e-15)
    torch.testing.assert_close(line.cos_lat, torch.cos(lat), rtol=0, atol=1e-15)
    torch.testing.assert_close(line.height, height, rtol=0, atol=5e-9)
    out, along = place_in_meridian(torch.sin(lat), torch.cos(lat), height)
    torch.testing.assert_close(line.axis, out, rtol=0, atol=5e-9)
    position = frames.ecef_from_geodetic(lat, lon, height)
    torch.testing.assert_close(along, position[:, 2], rtol=0, atol=5e-9)


def test_gravity_is_normal_gravity_along_the_normal():
    lat, lon, height = _places()
    found = torch.stack(gravity_at(*frames.ecef_from_geodetic(lat, lon, height).unbind(-1)), -1)
    up = frames.enu_from_ecef_matrix(lat, lon)[:, 2]
    expected = -earth.normal_gravity(lat, height).unsqueeze(-1) * up
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-13)


def test_level_turns_into_the_earth_frame():
    lat, lon, _ = _places()
    parts = level_to_meridian(
        torch.sin(lat), torch.cos(lat), torch.cos(lon / 2), torch.sin(lon / 2)
    )
    found = attitude.matrix_from_quaternion(torch.stack(parts, -1))
    expected = frames.enu_from_ecef_matrix(lat, lon).transpose(-1, -2)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("length", "error"), [(1.0, 3e-9), (100.0, 3e-9), (3000.0, 1e-6)])
@pytest.mark.parametrize("direction", [0.3, 2.0, 4.4])
def test_a_short_way_leads_to_the_same_place_as_in_cartesian_coordinates(length, error, direction):
    lat, lon, height = (x[1:6] for x in _places())
    way = length * torch.tensor((math.sin(direction), math.cos(direction), 0.1)).double()
    way = way.expand(5, 3)
    to_level = frames.enu_from_ecef_matrix(lat, lon)
    there = frames.ecef_from_geodetic(lat, lon, height) + torch.einsum("nji,nj->ni", to_level, way)
    moved = geodetic_change(lat, height, way)
    found = frames.ecef_from_geodetic(lat + moved.lat, lon + moved.lon, height + moved.height)
    assert float((found - there).norm(dim=-1).max()) < error
    gravity = torch.stack(gravity_at(*there.unbind(-1)), -1)
    expected = torch.einsum("nij,nj->ni", to_level, gravity)
    found = gravity_on_the_way(lat, height, way)
    assert float((found - expected).norm(dim=-1).max()) < 1e-12 + 1e-12 * length**2
