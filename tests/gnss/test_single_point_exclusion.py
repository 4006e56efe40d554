"""Which ranges a single-point position leaves out: wild ones, senseless ones, low satellites."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch

from navlearn.gnss.single_point import Reason, single_point
from navlearn.gnss.single_point_options import SinglePointOptions

MakeSky = Callable[..., Any]


def test_share_refused_is_the_one_stated(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8, receptions=4000, seed=5)
    found = single_point(sky.noisy(), SinglePointOptions(probability=0.95, exclusions=0))
    share = float((found.reason == Reason.INCONSISTENT).double().mean())
    assert share == pytest.approx(0.05, abs=0.012)


@pytest.mark.parametrize("size", [300.0, 1e4, 1e6, 1e8])
def test_one_wild_range_is_excluded(make_sky: MakeSky, size: float) -> None:
    sky = make_sky(satellites=9, receptions=20, seed=6)
    pseudorange = sky.ranges.pseudorange.clone()
    which = torch.arange(20) % 9
    pseudorange[torch.arange(20), which] += size
    found = single_point(sky.ranges._replace(pseudorange=pseudorange))
    assert found.ok.all()
    assert (sky.errors(found).abs() < 1e-5).all()
    assert torch.equal(found.excluded, torch.nn.functional.one_hot(which, 9).double())
    assert (found.satellites == 8).all()
    at_fault = found.residual[torch.arange(20), which]
    torch.testing.assert_close(at_fault, torch.full((20,), size).double(), rtol=1e-5, atol=0.0)


def test_two_wild_ranges_are_excluded(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=12, receptions=20, seed=7)
    pseudorange = sky.ranges.pseudorange.clone()
    pseudorange[:, 2] += 500.0
    pseudorange[:, 7] -= 2000.0
    found = single_point(sky.ranges._replace(pseudorange=pseudorange))
    assert found.ok.all()
    assert (sky.errors(found).abs() < 1e-5).all()
    assert (found.excluded[:, [2, 7]] == 1.0).all()
    assert (found.excluded.sum(-1) == 2.0).all()


def test_fault_without_a_satellite_to_spare_is_seen(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=5, receptions=20, seed=8)
    pseudorange = sky.ranges.pseudorange.clone()
    pseudorange[:, 0] += 1e6
    found = single_point(sky.ranges._replace(pseudorange=pseudorange))
    assert not found.ok.any()
    assert set(found.reason.tolist()) <= {Reason.INCONSISTENT, Reason.IMPLAUSIBLE, Reason.GEOMETRY}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_senseless_values_are_left_out(make_sky: MakeSky, value: float) -> None:
    sky = make_sky(satellites=8)
    pseudorange, satellite = sky.ranges.pseudorange.clone(), sky.ranges.satellite.clone()
    pseudorange[:, 0] = value
    satellite[:, 1, 2] = value
    satellite[:, 2] = 0.0  # as where an ephemeris is missing
    found = single_point(sky.ranges._replace(pseudorange=pseudorange, satellite=satellite))
    assert found.ok.all()
    assert (sky.errors(found).abs() < 1e-4).all()
    assert (found.satellites == 5).all()
    assert (found.excluded[:, :3] == 1.0).all()


def test_low_satellites_are_not_used(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=9)
    found = single_point(sky.ranges, SinglePointOptions(elevation_mask=0.6))
    assert torch.equal(found.used > 0.0, sky.ranges.elevation >= 0.6)
    assert not found.excluded.any()
