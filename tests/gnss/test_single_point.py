"""Single-point positions against the geometry that made the ranges, and other solvers."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from navlearn import wgs84
from navlearn.errors import ConfigError, ShapeError
from navlearn.frames import ecef_from_geodetic, enu_between, enu_from_ecef_matrix
from navlearn.gnss.range_noise import (
    RangeNoiseOptions,
    log_range_noise,
    range_noise,
    range_noise_from_log,
    range_variance,
)
from navlearn.gnss.range_rate_velocity import range_rate_velocity
from navlearn.gnss.single_point import Reason, SinglePoint, single_point
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.states import SatelliteRanges

MakeSky = Callable[..., Any]
PLAIN = SinglePointOptions(probability=1.0, huber=math.inf)


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


def errors(found: SinglePoint, sky: Any) -> Tensor:
    """Return position errors east, north, up, m, shape (M, 3)."""
    enu = enu_between(found.lat, found.lon, found.height, sky.lat, sky.lon, sky.height)
    return torch.stack(enu, dim=-1)


def noisy(sky: Any, seed: int = 1) -> SatelliteRanges:
    """Return the ranges with errors as the default noise has them."""
    ranges = sky.ranges
    noise = range_noise(RangeNoiseOptions())
    deviation = range_variance(noise, ranges.elevation, ranges.cn0, ranges.std_range).sqrt()
    draw = torch.Generator().manual_seed(seed)
    error = deviation * torch.randn(deviation.shape, generator=draw, dtype=torch.float64)
    return ranges._replace(pseudorange=ranges.pseudorange + error)


@pytest.mark.parametrize("systems", [1, 2, 3])
def test_exact_without_noise(make_sky: MakeSky, systems: int) -> None:
    sky = make_sky(satellites=10, systems=systems)
    found = single_point(sky.ranges)
    assert found.ok.all()
    torch.testing.assert_close(
        errors(found, sky), torch.zeros(5, 3), atol=1e-6, rtol=0.0, check_dtype=False
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
    assert (errors(left_as_sent, sky).norm(dim=-1) > 10.0).all()
    turned = torch.stack(
        (c * sent[..., 0] + s * sent[..., 1], c * sent[..., 1] - s * sent[..., 0], z), -1
    )
    again = single_point(sky.ranges._replace(satellite=turned))
    assert (errors(again, sky).abs() < 1e-6).all()


@pytest.mark.parametrize("huber", [math.inf, 1.345])
def test_as_scipy_solves_it(make_sky: MakeSky, huber: float) -> None:
    sky = make_sky(satellites=9, systems=2, receptions=3)
    ranges = noisy(sky)
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
    found = single_point(noisy(replace(sky, ranges=many)), PLAIN)
    error = errors(found, sky)
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


def test_share_refused_is_the_one_stated(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8, receptions=4000, seed=5)
    found = single_point(noisy(sky), SinglePointOptions(probability=0.95, exclusions=0))
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
    assert (errors(found, sky).abs() < 1e-5).all()
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
    assert (errors(found, sky).abs() < 1e-5).all()
    assert (found.excluded[:, [2, 7]] == 1.0).all()
    assert (found.excluded.sum(-1) == 2.0).all()


def test_fault_without_a_satellite_to_spare_is_seen(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=5, receptions=20, seed=8)
    pseudorange = sky.ranges.pseudorange.clone()
    pseudorange[:, 0] += 1e6
    found = single_point(sky.ranges._replace(pseudorange=pseudorange))
    assert not found.ok.any()
    assert set(found.reason.tolist()) <= {Reason.INCONSISTENT, Reason.IMPLAUSIBLE, Reason.GEOMETRY}


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
        assert (errors(found, sky).abs() < 1e-4).all()
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
        assert (errors(found, sky).abs() < 1e-4).all()
        assert torch.isinf(found.clock_std[:, 1]).all()
        assert bool(torch.isinf(found.clock_std[:, 0]).all()) == (alone == 1)
    assert single_point(sky.ranges, systems=3).clock.shape == (5, 3)


def test_clock_jumps_between_receptions_change_nothing_else(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=8)
    jumps = 299792458.0 * 1e-3 * torch.arange(5).double().unsqueeze(-1)
    before = single_point(sky.ranges)
    after = single_point(sky.ranges._replace(pseudorange=sky.ranges.pseudorange + jumps))
    assert after.ok.all()
    torch.testing.assert_close(after.clock - before.clock, jumps, atol=1e-5, rtol=0.0)
    assert (errors(after, sky).abs() < 1e-5).all()


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


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_senseless_values_are_left_out(make_sky: MakeSky, value: float) -> None:
    sky = make_sky(satellites=8)
    pseudorange, satellite = sky.ranges.pseudorange.clone(), sky.ranges.satellite.clone()
    pseudorange[:, 0] = value
    satellite[:, 1, 2] = value
    satellite[:, 2] = 0.0  # as where an ephemeris is missing
    found = single_point(sky.ranges._replace(pseudorange=pseudorange, satellite=satellite))
    assert found.ok.all()
    assert (errors(found, sky).abs() < 1e-4).all()
    assert (found.satellites == 5).all()
    assert (found.excluded[:, :3] == 1.0).all()


def test_low_satellites_are_not_used(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=9)
    found = single_point(sky.ranges, SinglePointOptions(elevation_mask=0.6))
    assert torch.equal(found.used > 0.0, sky.ranges.elevation >= 0.6)
    assert not found.excluded.any()


def test_batch_equals_loop(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=9, receptions=6, systems=2)
    ranges = noisy(sky)
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
    ranges = noisy(sky)
    centre = single_point(ranges)
    near = single_point(ranges, start=(sky.lat + 0.01, sky.lon, sky.height))
    for name in ("lat", "lon", "height", "clock", "residual"):
        torch.testing.assert_close(
            getattr(near, name), getattr(centre, name), rtol=1e-13, atol=1e-6
        )


def test_derivatives_to_pseudoranges(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7, receptions=2, systems=2)
    ranges = noisy(sky)
    options = PLAIN

    def solution(pseudorange: Tensor) -> Tensor:
        found = single_point(ranges._replace(pseudorange=pseudorange), options)
        east, north, up = enu_between(
            found.lat, found.lon, found.height, sky.lat, sky.lon, sky.height
        )
        return torch.cat((torch.stack((east, north, up), -1), found.clock), dim=-1)

    pseudorange = ranges.pseudorange.clone().requires_grad_()
    assert torch.autograd.gradcheck(solution, (pseudorange,), eps=0.1, atol=1e-6, rtol=1e-4)


def test_derivatives_to_noise(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7, receptions=2)
    ranges = noisy(sky)
    options = PLAIN

    def spread(log: Tensor) -> Tensor:
        found = single_point(ranges, options, noise=range_noise_from_log(log))
        return torch.cat((found.covariance.flatten(), found.test))

    log = log_range_noise(RangeNoiseOptions()).requires_grad_()
    assert torch.autograd.gradcheck(spread, (log,), eps=1e-3, atol=1e-4, rtol=1e-4)


def test_derivatives_are_finite_where_nothing_is_solved(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7)
    has = sky.ranges.has_range.clone()
    has[0], has[1, 2:] = 0.0, 0.0
    pseudorange = sky.ranges.pseudorange.clone().requires_grad_()
    found = single_point(sky.ranges._replace(has_range=has, pseudorange=pseudorange))
    total = found.lat.sum() + found.height.sum() + found.clock.sum() + found.test.sum()
    (gradient,) = torch.autograd.grad(total + found.covariance.sum(), pseudorange)
    assert torch.isfinite(gradient).all()
    assert (gradient[2:] != 0.0).any()


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
