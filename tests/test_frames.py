"""Geodetic, Earth-fixed and local positions against closed cases and each other."""

import math

import pytest
import torch
from scipy import integrate

from navlearn import earth, frames, wgs84


def _t(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _grid() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    lat = torch.linspace(-math.pi / 2, math.pi / 2, 37, dtype=torch.float64)
    lon = torch.linspace(-3.1, 3.1, 8, dtype=torch.float64)
    height = _t(-500.0, 0.0, 100.0, 9000.0)
    return tuple(x.reshape(-1) for x in torch.meshgrid(lat, lon, height, indexing="ij"))


def test_ecef_on_the_axes():
    found = frames.ecef_from_geodetic(
        _t(0.0, 0.0, math.pi / 2), _t(0.0, math.pi / 2, 0.0), _t(0.0, 10.0, -5.0)
    )
    a, b = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS
    expected = torch.tensor([[a, 0, 0], [0, a + 10, 0], [0, 0, b - 5]], dtype=torch.float64)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


def test_ecef_lies_on_the_ellipsoid_and_height_along_its_normal():
    lat, lon, height = _grid()
    foot = frames.ecef_from_geodetic(lat, lon, torch.zeros_like(height))
    a, b = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS
    scale = _t(1 / a**2, 1 / a**2, 1 / b**2)
    torch.testing.assert_close(
        (foot * foot * scale).sum(-1), torch.ones_like(lat), rtol=0, atol=1e-14
    )
    normal = torch.nn.functional.normalize(foot * scale, dim=-1)
    found = frames.ecef_from_geodetic(lat, lon, height)
    torch.testing.assert_close(found, foot + height.unsqueeze(-1) * normal, rtol=0, atol=1e-8)


def test_geodetic_returns_from_ecef_to_a_nanometre_of_rounding():
    lat, lon, height = _grid()
    found = frames.geodetic_from_ecef(frames.ecef_from_geodetic(lat, lon, height))
    assert (found[0] - lat).abs().max() * wgs84.SEMI_MAJOR_AXIS < 4e-9
    assert (found[2] - height).abs().max() < 4e-9
    away = torch.cos(lat) > 1e-6
    assert (found[1] - lon)[away].abs().max() < 1e-14


def test_enu_matrix_is_a_rotation_whose_rows_are_the_slopes_of_position():
    lat, lon, height = _t(0.7, -0.2), _t(-1.3, 2.5), _t(100.0, 0.0)
    C_le = frames.enu_from_ecef_matrix(lat, lon)
    torch.testing.assert_close(
        C_le @ C_le.mT, torch.eye(3).double().expand(2, 3, 3), rtol=0, atol=1e-15
    )
    assert torch.linalg.det(C_le).min() > 0
    jacobian = torch.func.vmap(torch.func.jacrev(lambda x: frames.ecef_from_geodetic(*x)))(
        torch.stack((lon, lat, height), -1)[:, [1, 0, 2]]
    )
    slopes = C_le @ jacobian
    r_m, r_n = earth.meridian_radius(lat), earth.prime_vertical_radius(lat)
    torch.testing.assert_close(slopes[:, 0, 1], (r_n + height) * torch.cos(lat))
    torch.testing.assert_close(slopes[:, 1, 0], r_m + height)
    torch.testing.assert_close(slopes[:, 2, 2], torch.ones_like(lat))


def test_north_over_a_kilometre_is_the_meridian_arc():
    lat_0, lat_1 = 0.77, 0.77 + 1000.0 / 6.37e6
    arc, _ = integrate.quad(lambda x: float(earth.meridian_radius(_t(x))), lat_0, lat_1)
    zero = _t(0.0)
    _, north, _ = frames.enu_between(_t(lat_1), zero, zero, _t(lat_0), zero, zero)
    assert north.item() == pytest.approx(arc, abs=1e-6)


def test_small_differences_equal_the_rotated_ecef_difference():
    lat, lon, height = _t(0.77), _t(-1.3), _t(80.0)
    moved = frames.shift_geodetic(lat, lon, height, _t(30.0), _t(-40.0), _t(5.0))
    chord = frames.ecef_from_geodetic(*moved) - frames.ecef_from_geodetic(lat, lon, height)
    by_matrix = (frames.enu_from_ecef_matrix(lat, lon) @ chord.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(by_matrix[0], _t(30.0, -40.0, 5.0), rtol=0, atol=1e-3)
    back = frames.enu_between(*moved, lat, lon, height)
    torch.testing.assert_close(torch.cat(back), _t(30.0, -40.0, 5.0), rtol=0, atol=1e-3)


def test_difference_over_a_kilometre_errs_by_millimetres():
    lat, lon, height = _t(0.77), _t(-1.3), _t(80.0)
    there = (lat + 700.0 / 6.37e6, lon + 700.0 / 4.58e6, height)
    east, north, _ = frames.enu_between(*there, lat, lon, height)
    mid = frames.enu_from_ecef_matrix(0.5 * (lat + there[0]), 0.5 * (lon + there[1]))
    chord = frames.ecef_from_geodetic(*there) - frames.ecef_from_geodetic(lat, lon, height)
    by_matrix = (mid @ chord.unsqueeze(-1)).squeeze(-1)[0]
    assert math.hypot(east - by_matrix[0], north - by_matrix[1]) < 1e-3


def test_a_shift_of_any_length_is_found_again():
    lat, lon, height = _t(0.77, -1.4, 0.1), _t(-1.3, 3.1415, -3.1415), _t(80.0, 9000.0, -20.0)
    way = (_t(3e4, 7e3, -8e4), _t(-4e4, 900.0, 2e5), _t(500.0, -20.0, 3.0))
    moved = frames.shift_geodetic(lat, lon, height, *way)
    back = frames.shift_between(*moved, lat, lon, height)
    torch.testing.assert_close(torch.stack(back), torch.stack(way), rtol=0, atol=1e-7)
    turned = frames.shift_between(moved[0], moved[1] - 2 * math.pi, moved[2], lat, lon, height)
    torch.testing.assert_close(torch.stack(turned), torch.stack(way), rtol=0, atol=1e-7)


def test_functions_script():
    lat, lon, height = (x[:50] for x in _grid())
    ecef = frames.ecef_from_geodetic(lat, lon, height)
    assert torch.equal(torch.jit.script(frames.ecef_from_geodetic)(lat, lon, height), ecef)
    scripted = torch.jit.script(frames.geodetic_from_ecef)(ecef)
    for found, expected in zip(scripted, frames.geodetic_from_ecef(ecef), strict=True):
        assert torch.equal(found, expected)
    for function in (frames.enu_between, frames.shift_between, frames.shift_geodetic):
        arguments = (lat, lon, height, lat * 0.9, lon, height + 1.0)
        for found, expected in zip(
            torch.jit.script(function)(*arguments), function(*arguments), strict=True
        ):
            assert torch.equal(found, expected)


def test_functions_differentiate():
    lat, lon, height = _t(0.7, -1.1), _t(-1.3, 0.2), _t(80.0, 900.0)
    inputs = tuple(x.requires_grad_() for x in (lat, lon, height))
    scaled = lambda *x: frames.ecef_from_geodetic(*x) / 1e6  # noqa: E731
    assert torch.autograd.gradcheck(scaled, inputs)
    ecef = (frames.ecef_from_geodetic(*inputs).detach() / 1e6).requires_grad_()

    def back(position):
        lat, lon, height = frames.geodetic_from_ecef(position * 1e6)
        return lat, lon, height / 1e6

    assert torch.autograd.gradcheck(back, ecef)


def test_a_way_across_the_antimeridian_is_short_and_differentiable():
    lat, height, far = _t(-0.3, -0.3, 0.5), _t(0.0, 10.0, 0.0), math.pi
    lon, lon_0 = _t(-far + 1e-5, far - 1e-5, -1.0), _t(far - 1e-5, -far + 1e-5, 2 * far - 1.0)
    east, north, up = frames.enu_between(lat, lon, height, lat, lon_0, height)
    expected = frames.enu_between(lat, _t(2e-5, -2e-5, 0.0), height, lat, _t(0.0, 0.0, 0.0), height)
    torch.testing.assert_close(
        torch.stack((east, north, up)), torch.stack(expected), atol=1e-8, rtol=0
    )
    a, b = (x.clone().requires_grad_() for x in (lon, lon_0))
    frames.enu_between(lat, a, height, lat, b, height)[0].sum().backward()
    radius = (earth.prime_vertical_radius(lat) + height) * torch.cos(lat)
    torch.testing.assert_close(a.grad, radius)
    torch.testing.assert_close(b.grad, -radius)
