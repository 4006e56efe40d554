"""Whatever ranges hold, a position is refused with a reason and nothing raises."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.errors import ConfigError, ShapeError
from navlearn.frames import ecef_from_geodetic, enu_from_ecef_matrix
from navlearn.gnss.range_rate_velocity import range_rate_velocity
from navlearn.gnss.single_point import single_point
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.states import SatelliteRanges

MakeSky = Callable[..., Any]


def garbage_sky() -> SatelliteRanges:
    """Return two receptions of seven satellites, coarse but consistent."""
    azimuth, elevation = torch.arange(7).double() * 0.9, 0.3 + 0.15 * torch.arange(7).double()
    level = torch.cos(elevation)
    unit = torch.stack(
        (level * torch.sin(azimuth), level * torch.cos(azimuth), torch.sin(elevation)), -1
    )
    place = torch.tensor([0.8, 0.1, 100.0], dtype=torch.float64).unbind()
    away = 2.2e7 * unit @ enu_from_ecef_matrix(place[0], place[1])
    satellite = (ecef_from_geodetic(*place) + away).expand(2, 7, 3)
    one = torch.ones(2, 7, dtype=torch.float64)
    return SatelliteRanges(
        *(satellite, 1e-4 * satellite.flip(-1), 2.2e7 * one, 0.0 * one, elevation * one),
        *(45.0 * one, 0.0 * one, 0.0 * one, torch.arange(7) % 2, one, one),
    )


def test_refusals(make_sky: MakeSky) -> None:
    ranges = make_sky().ranges
    with pytest.raises(ShapeError, match="cn0 has shape"):
        single_point(ranges._replace(cn0=ranges.cn0[:, :4]))
    with pytest.raises(ShapeError, match=r"expected \(..., M, S\)"):
        single_point(ranges._replace(pseudorange=ranges.pseudorange[0]))
    for name, value in (("probability", 0.0), ("exclusions", -1), ("heights", (5.0, 1.0))):
        with pytest.raises(ConfigError, match=name):
            SinglePointOptions(**{name: value})


GARBAGE = st.sampled_from([0.0, -1.0, 1.0, 2e7, -2e7, 1e9, 1e30, math.nan, math.inf, -math.inf])


@settings(max_examples=60, deadline=None)
@given(
    data=st.data(),
    field=st.sampled_from([name for name in SatelliteRanges._fields if name != "system"]),
)
def test_whatever_a_field_holds_nothing_raises(data: st.DataObject, field: str) -> None:
    sky = garbage_sky()
    values = getattr(sky, field).clone()
    for _ in range(data.draw(st.integers(1, 6))):
        place = tuple(data.draw(st.integers(0, size - 1)) for size in values.shape)
        values[place] = data.draw(GARBAGE)
    ranges = sky._replace(**{field: values})
    found = single_point(ranges)
    place = (found.lat, found.lon, found.height)
    moving = range_rate_velocity(ranges, place)
    for part in (found, moving):
        for name, value in part._asdict().items():
            if name not in ("clock_std", "drift_std"):
                assert torch.isfinite(value).all(), name
    if field in ("range_rate", "satellite_velocity", "std_rate", "has_rate"):
        assert found.ok.all()


def test_velocity_at_no_place_is_none(make_sky: MakeSky) -> None:
    sky = make_sky()
    lat = sky.lat.clone()
    lat[0] = math.nan
    found = range_rate_velocity(sky.ranges, (lat, sky.lon, sky.height))
    assert found.ok.tolist() == [False, True, True, True, True]
    for value in (found.v_l, found.covariance, found.residual, found.test):
        assert torch.isfinite(value).all()
