"""The Earth's shape and gravity against published values and closed cases."""

import math

import pytest
import torch
from scipy import integrate

from navlearn import earth, wgs84


def _t(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_derived_constants_equal_the_published_ones():
    # NGA.STND.0036 (2014), tables 3.3 to 3.6
    assert pytest.approx(6356752.3142, abs=5e-5) == wgs84.SEMI_MINOR_AXIS
    assert pytest.approx(6.694379990141e-3, abs=5e-16) == wgs84.ECCENTRICITY_SQUARED
    # k is published to more digits than the gravities it follows from allow
    assert pytest.approx(1.93185265241e-3, abs=1e-11) == wgs84.SOMIGLIANA_CONSTANT
    assert pytest.approx(3.449786506841e-3, abs=5e-15) == wgs84.GRAVITY_RATIO


def test_radii_at_the_equator_and_the_pole_are_closed_forms():
    a, b = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS
    lat = _t(0.0, math.pi / 2)
    torch.testing.assert_close(
        earth.meridian_radius(lat), _t(b * b / a, a * a / b), rtol=1e-14, atol=0
    )
    torch.testing.assert_close(
        earth.prime_vertical_radius(lat), _t(a, a * a / b), rtol=1e-14, atol=0
    )


def test_meridian_radius_integrates_to_the_quarter_meridian():
    length, _ = integrate.quad(
        lambda lat: float(earth.meridian_radius(_t(lat))), 0.0, math.pi / 2, epsabs=1e-6
    )
    assert length == pytest.approx(10001965.7293, abs=1e-3)  # the WGS-84 quadrant


def test_gravity_on_the_ellipsoid_is_somiglianas_first_form():
    lat = torch.deg2rad(_t(0.0, 90.0, 45.0, -57.3))
    a, b = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS
    c2, s2 = torch.cos(lat) ** 2, torch.sin(lat) ** 2
    expected = (a * wgs84.EQUATORIAL_GRAVITY * c2 + b * wgs84.POLAR_GRAVITY * s2) / torch.sqrt(
        a * a * c2 + b * b * s2
    )
    found = earth.normal_gravity(lat, torch.zeros_like(lat))
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=0)
    torch.testing.assert_close(found[:2], _t(9.7803253359, 9.8321849378), rtol=1e-12, atol=0)


def test_gravity_with_height_follows_the_exact_field_of_the_equator():
    # in the equatorial plane the normal field has a closed form in u² = r² − E², [NGA2014] §4
    a, b = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS
    focal = math.sqrt(a * a - b * b)
    gm, rate = wgs84.GRAVITATIONAL_CONSTANT, wgs84.EARTH_RATE

    def q(u: float) -> float:
        return 0.5 * ((1 + 3 * u * u / focal**2) * math.atan(focal / u) - 3 * u / focal)

    def potential(r: float) -> float:
        u = math.sqrt(r * r - focal**2)
        flattened = 0.5 * rate**2 * a * a * q(u) / q(b) * (-1.0 / 3.0)
        return gm / focal * math.atan(focal / u) + flattened + 0.5 * rate**2 * r * r

    for height in (0.0, 500.0, 3000.0):
        r, step = a + height, 500.0
        exact = -(potential(r + step) - potential(r - step)) / (2 * step)
        found = float(earth.normal_gravity(_t(0.0), _t(height)))
        assert found == pytest.approx(exact, abs=3e-6)


def test_earth_rate_keeps_its_length_and_points_to_the_pole():
    lat = torch.deg2rad(_t(-90.0, 0.0, 30.0, 90.0))
    rate = earth.earth_rate_enu(lat)
    torch.testing.assert_close(rate.norm(dim=-1), torch.full_like(lat, wgs84.EARTH_RATE))
    torch.testing.assert_close(rate[1], _t(0.0, wgs84.EARTH_RATE, 0.0))
    torch.testing.assert_close(rate[2, 2], _t(0.5 * wgs84.EARTH_RATE)[0])
    assert rate[0, 2] == -wgs84.EARTH_RATE


def test_transport_rate_is_zero_at_rest_and_has_no_vertical_part_on_the_equator():
    zero = torch.zeros(1, dtype=torch.float64)
    assert torch.equal(
        earth.transport_rate_enu(zero + 0.7, zero, zero, zero), torch.zeros(1, 3).double()
    )
    moving = earth.transport_rate_enu(zero, zero, zero + 20.0, zero - 10.0)[0]
    a, b = wgs84.SEMI_MAJOR_AXIS, wgs84.SEMI_MINOR_AXIS
    torch.testing.assert_close(moving, _t(10.0 * a / (b * b), 20.0 / a, 0.0))


@pytest.mark.parametrize(
    "function",
    [earth.meridian_radius, earth.prime_vertical_radius, earth.earth_rate_enu],
    ids=lambda f: f.__name__,
)
def test_functions_of_latitude_script_and_differentiate(function):
    lat = _t(-1.2, 0.0, 0.8).requires_grad_()
    assert torch.equal(torch.jit.script(function)(lat), function(lat))
    assert torch.autograd.gradcheck(lambda x: function(x) / 1e3, lat)


def test_gravity_and_transport_rate_script_and_differentiate():
    lat, height = _t(-1.2, 0.0, 0.8).requires_grad_(), _t(0.0, 10.0, 2000.0).requires_grad_()
    v_e, v_n = _t(20.0, -3.0, 0.0).requires_grad_(), _t(5.0, 30.0, 0.0).requires_grad_()
    assert torch.equal(
        torch.jit.script(earth.normal_gravity)(lat, height), earth.normal_gravity(lat, height)
    )
    assert torch.equal(
        torch.jit.script(earth.transport_rate_enu)(lat, height, v_e, v_n),
        earth.transport_rate_enu(lat, height, v_e, v_n),
    )
    assert torch.autograd.gradcheck(earth.normal_gravity, (lat, height))
    scaled = lambda *x: earth.transport_rate_enu(*x) * 1e6  # noqa: E731
    assert torch.autograd.gradcheck(scaled, (lat, height, v_e, v_n))
