"""Few satellites, and satellites that stand so that they tell no position."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch

from navlearn.frames import ecef_from_geodetic, enu_from_ecef_matrix
from navlearn.gnss.single_point import Reason, single_point
from navlearn.states import SatelliteRanges

MakeSky = Callable[..., Any]


@pytest.mark.parametrize("count", range(10))
def test_any_number_of_satellites(make_sky: MakeSky, count: int) -> None:
    sky = make_sky(satellites=9, systems=2)
    has = torch.zeros_like(sky.ranges.has_range)
    has[:, :count] = 1.0
    found = single_point(sky.ranges._replace(has_range=has))
    for name, value in found._asdict().items():
        if name != "clock_std":
            assert torch.isfinite(value).all(), name
    needed = 5 if count > 1 else 4
    if count < needed:
        assert (found.reason == Reason.TOO_FEW).all()
        assert (found.satellites == count).all()
    else:
        assert found.ok.all()
        assert (sky.errors(found).abs() < 1e-4).all()
        assert (found.degrees == count - 5).all()


def test_no_satellite_slots_and_no_receptions(make_sky: MakeSky) -> None:
    ranges = make_sky().ranges
    none = SatelliteRanges(*(v[..., :0] if v.dim() < 3 else v[..., :0, :] for v in ranges))
    assert (single_point(none).reason == Reason.TOO_FEW).all()
    empty = SatelliteRanges(*(v if v is ranges.system else v[:0] for v in ranges))
    assert single_point(empty).lat.shape == (0,)


def test_one_system_alone(make_sky: MakeSky) -> None:
    """The second system costs nothing where it is not received; without the first, all go on."""
    sky = make_sky(satellites=12, systems=2)
    for alone in (0, 1):
        has = (sky.ranges.system == alone).double().expand(5, 12)
        found = single_point(sky.ranges._replace(has_range=has))
        assert found.ok.all()
        assert (sky.errors(found).abs() < 1e-4).all()
        assert torch.isinf(found.clock_std[:, 1]).all()
        assert bool(torch.isinf(found.clock_std[:, 0]).all()) == (alone == 1)
    assert single_point(sky.ranges, systems=3).clock.shape == (5, 3)


def test_satellites_that_cannot_tell_are_no_solution(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8)
    same = SatelliteRanges(
        *(v if v is sky.ranges.system else v[:, :1].expand_as(v) for v in sky.ranges)
    )
    assert (single_point(same).reason == Reason.GEOMETRY).all()


def test_satellites_in_a_plane_with_the_car(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8)
    car = ecef_from_geodetic(sky.lat, sky.lon, sky.height)
    # all on the meridian plane: nothing tells how far the car lies beside it
    across = torch.linalg.cross(car, torch.tensor([0.0, 0.0, 1.0]).double().expand_as(car))
    across = across / across.norm(dim=-1, keepdim=True)
    away = sky.ranges.satellite - car[:, None]
    away = away - (away * across[:, None]).sum(-1, keepdim=True) * across[:, None]
    clock = sky.clock[:, :1]
    flat = sky.ranges._replace(satellite=car[:, None] + away, pseudorange=away.norm(dim=-1) + clock)
    for start in (None, (sky.lat, sky.lon, sky.height)):
        found = single_point(flat, start=start)
        assert not found.ok.any()
        assert (found.reason == Reason.GEOMETRY).any()
        assert torch.isfinite(found.lat).all()


def test_satellites_at_one_elevation_leave_height_and_clock_together(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8)
    azimuth = torch.arange(8).double() * math.pi / 4.0
    unit = torch.stack((torch.sin(azimuth), torch.cos(azimuth), torch.ones(8).double()), -1)
    turn = enu_from_ecef_matrix(sky.lat, sky.lon)
    away = 2.2e7 * torch.nn.functional.normalize(unit, dim=-1) @ turn
    car = ecef_from_geodetic(sky.lat, sky.lon, sky.height)
    cone = sky.ranges._replace(satellite=car[:, None] + away, pseudorange=away.norm(dim=-1))
    found = single_point(cone, start=(sky.lat, sky.lon, sky.height))
    assert (found.reason == Reason.GEOMETRY).all()
