"""Single-point positions against the geometry that made the ranges, and other solvers."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import torch

from navlearn import wgs84
from navlearn.frames import ecef_from_geodetic
from navlearn.gnss.range_noise import (
    RangeNoiseOptions,
    range_noise,
    range_variance,
)
from navlearn.gnss.single_point import single_point
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.states import SatelliteRanges

MakeSky = Callable[..., Any]
PLAIN = SinglePointOptions(probability=1.0, huber=math.inf)


@pytest.mark.parametrize("systems", [1, 2, 3])
def test_exact_without_noise(make_sky: MakeSky, systems: int) -> None:
    sky = make_sky(satellites=10, systems=systems)
    found = single_point(sky.ranges)
    assert found.ok.all()
    torch.testing.assert_close(
        sky.errors(found), torch.zeros(5, 3), atol=1e-6, rtol=0.0, check_dtype=False
    )
    torch.testing.assert_close(found.clock, sky.clock, atol=1e-6, rtol=0.0)
    assert (found.degrees == 10 - 3 - systems).all()
    assert (found.residual.abs() < 1e-6).all()


def test_exact_with_the_earth_turning(make_sky: MakeSky) -> None:
    """Signals sent in inertial space: the satellite's axes turn while the signal travels."""
    sky = make_sky(satellites=8)
    car = ecef_from_geodetic(sky.lat, sky.lon, sky.height).unsqueeze(-2)
    received = sky.ranges.satellite
    travel = torch.linalg.vector_norm(received - car, dim=-1) / 299792458.0
    angle = wgs84.EARTH_RATE * travel
    c, s = torch.cos(angle), torch.sin(angle)
    x, y, z = received.unbind(-1)
    sent = torch.stack((c * x - s * y, s * x + c * y, z), dim=-1)
    left_as_sent = single_point(sky.ranges._replace(satellite=sent))
    assert (sky.errors(left_as_sent).norm(dim=-1) > 10.0).all()
    turned = torch.stack(
        (c * sent[..., 0] + s * sent[..., 1], c * sent[..., 1] - s * sent[..., 0], z), -1
    )
    again = single_point(sky.ranges._replace(satellite=turned))
    assert (sky.errors(again).abs() < 1e-6).all()


@pytest.mark.parametrize("huber", [math.inf, 1.345])
def test_as_scipy_solves_it(make_sky: MakeSky, huber: float) -> None:
    sky = make_sky(satellites=9, systems=2, receptions=3)
    ranges = sky.noisy()
    ranges.pseudorange[:, 4] += 40.0
    found = single_point(ranges, SinglePointOptions(probability=1.0, huber=huber))
    noise = range_noise(RangeNoiseOptions())
    weight = range_variance(noise, ranges.elevation, ranges.cn0, ranges.std_range).rsqrt().numpy()
    system = ranges.system.numpy()
    for m in range(3):
        satellite, pseudorange = ranges.satellite[m].numpy(), ranges.pseudorange[m].numpy()
        plain = _by_scipy(satellite, pseudorange, weight[m], system, math.inf)
        other = _by_scipy(satellite, pseudorange, weight[m], system, huber)
        own = ecef_from_geodetic(found.lat[m], found.lon[m], found.height[m])
        np.testing.assert_allclose(own.numpy(), other.x[:3], atol=5e-3)
        np.testing.assert_allclose(found.clock[m].numpy(), other.x[3:], atol=5e-3)
        assert float(found.test[m]) == pytest.approx(2.0 * plain.cost, rel=1e-4)
        if huber < math.inf:
            assert np.linalg.norm(plain.x[:3] - other.x[:3]) > 0.1


def _by_scipy(
    satellite: np.ndarray, pseudorange: np.ndarray, weight: np.ndarray, system: np.ndarray, k: float
) -> Any:
    def residual(x: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(satellite - x[:3], axis=-1)
        return weight * (pseudorange - distance - x[3] - np.where(system == 1, x[4], 0.0))

    robust = {"loss": "huber", "f_scale": k} if k < math.inf else {}
    scale, tight = [1e6, 1e6, 1e6, 1e6, 1e3], dict.fromkeys(("ftol", "xtol", "gtol"), 1e-15)
    x0 = scipy.optimize.least_squares(
        residual, np.array([1e6, -4e6, 4e6, 0.0, 0.0]), x_scale=scale, **tight
    )
    # from there, since far away every residual lies on the robust loss's straight part
    return scipy.optimize.least_squares(residual, x0.x, x_scale=scale, **tight, **robust)


def test_covariance_and_test_by_monte_carlo(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8, systems=2, receptions=1, seed=4)
    draws = 4000
    many = SatelliteRanges(
        *(
            value if name == "system" else value.expand(draws, *value.shape[1:])
            for name, value in sky.ranges._asdict().items()
        )
    )
    found = single_point(replace(sky, ranges=many).noisy(), PLAIN)
    error = sky.errors(found)
    sampled = error.T @ error / draws
    stated = found.covariance.mean(0)
    torch.testing.assert_close(sampled, stated, rtol=0.1, atol=0.15)
    clock = found.clock - sky.clock
    torch.testing.assert_close(
        (clock**2).mean(0).sqrt(), found.clock_std.mean(0), rtol=0.05, atol=0.0
    )
    # mean of χ² with 3 degrees is 3, deviation of that mean √(6 / draws) = 0.04
    assert found.degrees.unique().tolist() == [3]
    assert float(found.test.mean()) == pytest.approx(3.0, abs=0.16)


def test_clock_jumps_between_receptions_change_nothing_else(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8)
    jumps = 299792458.0 * 1e-3 * torch.arange(5).double().unsqueeze(-1)
    before = single_point(sky.ranges)
    after = single_point(sky.ranges._replace(pseudorange=sky.ranges.pseudorange + jumps))
    assert after.ok.all()
    torch.testing.assert_close(after.clock - before.clock, jumps, atol=1e-5, rtol=0.0)
    assert (sky.errors(after).abs() < 1e-5).all()


def test_batch_equals_loop(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=9, receptions=6, systems=2)
    ranges = sky.noisy()
    ranges.pseudorange[2, 3] += 1e3
    whole = single_point(ranges)
    stacked = SatelliteRanges(
        *(
            v.expand(2, -1) if name == "system" else v.reshape(2, 3, *v.shape[1:])
            for name, v in ranges._asdict().items()
        )
    )
    for name, value in single_point(stacked)._asdict().items():
        torch.testing.assert_close(value.flatten(0, 1), getattr(whole, name), rtol=1e-12, atol=1e-9)
    for m in range(6):
        one = SatelliteRanges(
            *(v if n == "system" else v[m : m + 1] for n, v in ranges._asdict().items())
        )
        alone = single_point(one, systems=2)
        for name, value in alone._asdict().items():
            torch.testing.assert_close(value[0], getattr(whole, name)[m], rtol=1e-9, atol=1e-7)


def test_start_does_not_matter(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7)
    ranges = sky.noisy()
    centre = single_point(ranges)
    near = single_point(ranges, start=(sky.lat + 0.01, sky.lon, sky.height))
    for name in ("lat", "lon", "height", "clock", "residual"):
        torch.testing.assert_close(
            getattr(near, name), getattr(centre, name), rtol=1e-13, atol=1e-6
        )
