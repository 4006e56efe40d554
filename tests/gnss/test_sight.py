"""Lines of sight and the Earth's turn: closed cases and derivatives."""

import math

import torch
from torch import Tensor

from navlearn import earth, frames, wgs84
from navlearn.gnss import signals
from navlearn.gnss.earth_rotation import in_axes_of_reception
from navlearn.gnss.sight import sight

LAT, LON, HEIGHT = (torch.tensor(value, dtype=torch.float64) for value in (0.85, 0.16, 330.0))


def placed(east: float, north: float, up: float) -> Tensor:
    """Return what stands so far from the car, Earth-fixed."""
    away = torch.tensor([east, north, up], dtype=torch.float64)
    turn = frames.enu_from_ecef_matrix(LAT, LON)
    return frames.ecef_from_geodetic(LAT, LON, HEIGHT) + turn.transpose(-1, -2) @ away


def test_directions_of_the_compass() -> None:
    r = 2e7
    seen = sight(
        LAT,
        LON,
        HEIGHT,
        torch.stack(
            [placed(0, r, r), placed(r, 0, 0), placed(0, -r, 0), placed(-r, 0, -r), placed(0, 0, r)]
        ),
    )
    quarter = math.pi / 4
    expected = torch.tensor([quarter, 0.0, 0.0, -quarter, 2 * quarter], dtype=torch.float64)
    torch.testing.assert_close(seen.elevation, expected, atol=1e-7, rtol=0.0)
    azimuth = torch.tensor([0.0, 2 * quarter, 4 * quarter, -2 * quarter], dtype=torch.float64)
    torch.testing.assert_close(seen.azimuth[:4].abs(), azimuth.abs(), atol=1e-7, rtol=0.0)
    assert seen.azimuth[1] > 0.0 > seen.azimuth[3]
    torch.testing.assert_close(seen.distance[0], torch.tensor(r * math.sqrt(2.0)).double())
    torch.testing.assert_close(
        seen.unit[4], torch.tensor([0.0, 0.0, 1.0]).double(), atol=1e-7, rtol=0
    )


def test_distance_falls_with_the_way_towards_the_satellite() -> None:
    lat, lon, height = (part.clone().requires_grad_() for part in (LAT, LON, HEIGHT))
    seen = sight(lat, lon, height, placed(1.1e7, -0.7e7, 1.9e7).unsqueeze(0))
    d_lat, d_lon, d_height = torch.autograd.grad(seen.distance.sum(), (lat, lon, height))
    radius_n = (earth.prime_vertical_radius(LAT) + HEIGHT) * torch.cos(LAT)
    by_car = torch.stack(
        (d_lon / radius_n, d_lat / (earth.meridian_radius(LAT) + HEIGHT), d_height)
    )
    torch.testing.assert_close(by_car, -seen.unit[0].detach())


def test_gradients() -> None:
    satellites = torch.stack([placed(1.1e7, -0.7e7, 1.9e7), placed(-2e7, 0.3e7, 0.5e7)])

    def angles(lat: Tensor, lon: Tensor, height: Tensor) -> tuple[Tensor, ...]:
        seen = sight(lat, lon, 1e6 * height, satellites)
        return seen.unit, seen.elevation, seen.azimuth

    inputs = [p.clone().requires_grad_() for p in (LAT, LON, HEIGHT * 1e-6)]
    assert torch.autograd.gradcheck(angles, inputs, eps=1e-6, atol=1e-6)


def test_the_zenith_has_angles_and_finite_derivatives() -> None:
    lat = torch.tensor(0.0, dtype=torch.float64, requires_grad=True)
    zero = torch.zeros((), dtype=torch.float64)
    seen = sight(lat, zero, zero, torch.tensor([[2.6e7, 0.0, 0.0]], dtype=torch.float64))
    assert float(seen.elevation.detach()) == math.pi / 2
    assert float(seen.azimuth.detach()) == 0.0
    (slope,) = torch.autograd.grad((seen.elevation + seen.azimuth).sum(), lat)
    assert torch.isfinite(slope)


def test_batch_equals_loop() -> None:
    generator = torch.Generator().manual_seed(3)
    lat, lon = torch.rand(2, 4, generator=generator, dtype=torch.float64)
    satellites = 2e7 * torch.randn(4, 5, 3, generator=generator, dtype=torch.float64)
    height = torch.zeros(4, dtype=torch.float64)
    together = sight(lat, lon, height, satellites)
    for k in range(4):
        alone = sight(lat[k], lon[k], height[k], satellites[k])
        for batched, single in zip(together, alone, strict=True):
            torch.testing.assert_close(batched[k], single, atol=1e-12, rtol=1e-12)


def test_streaming_code_can_script_it() -> None:
    satellite = placed(1e7, 1e7, 1e7).unsqueeze(0)
    scripted = torch.jit.script(sight)(LAT, LON, HEIGHT, satellite)
    torch.testing.assert_close(tuple(scripted), tuple(sight(LAT, LON, HEIGHT, satellite)))


def test_rotation_of_the_earth() -> None:
    satellite = torch.tensor([1.5e7, -1.2e7, 1.8e7], dtype=torch.float64)
    travel = torch.tensor(0.075, dtype=torch.float64)
    turned = in_axes_of_reception(satellite, travel)
    # in space the axes have turned with the Earth, so that what stands still falls behind
    angle = 0.075 * 7.292115e-5
    back = torch.tensor(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]],
        dtype=torch.float64,
    )
    torch.testing.assert_close(back @ turned, satellite)
    torch.testing.assert_close(in_axes_of_reception(turned, -travel), satellite)


def test_the_way_grows_by_the_sagnac_term() -> None:
    satellite = torch.tensor([1.5e7, -1.2e7, 1.8e7], dtype=torch.float64)
    receiver = frames.ecef_from_geodetic(LAT, LON, HEIGHT)
    straight = torch.linalg.vector_norm(satellite - receiver)
    turned = in_axes_of_reception(satellite, straight / signals.SPEED_OF_LIGHT)
    longer = torch.linalg.vector_norm(turned - receiver) - straight
    area = satellite[0] * receiver[1] - satellite[1] * receiver[0]
    sagnac = wgs84.EARTH_RATE / signals.SPEED_OF_LIGHT * area
    assert abs(float(sagnac)) > 10.0
    torch.testing.assert_close(longer, sagnac, atol=1e-3, rtol=0.0)


def test_a_day_of_travel_turns_once() -> None:
    vector = torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64)
    day = torch.tensor([2.0 * math.pi / wgs84.EARTH_RATE], dtype=torch.float64)
    torch.testing.assert_close(in_axes_of_reception(vector, day), vector)
