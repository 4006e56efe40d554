"""Delays of ionosphere and troposphere: limits, a second transcription, and RTKLIB."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.gnss import signals
from navlearn.gnss.klobuchar import klobuchar_delay
from navlearn.gnss.troposphere import saastamoinen_delay, slant_factor, zenith_delays

STUTTGART_2023 = (1.4901e-8, 2.2352e-8, -1.1921e-7, -1.1921e-7, 114690, 163840, -65536, -458750)


def tensor(*values: float) -> Tensor:
    return torch.tensor(values if len(values) > 1 else values[0], dtype=torch.float64)


def klobuchar_in_degrees(
    lat_deg: float, lon_deg: float, elevation_deg: float, azimuth_deg: float, tow: float
) -> float:
    """Return the delay in metres, written down anew from the figure of the interface document."""
    alpha, beta = STUTTGART_2023[:4], STUTTGART_2023[4:]
    e = elevation_deg / 180
    psi = 0.0137 / (e + 0.11) - 0.022
    phi_i = lat_deg / 180 + psi * np.cos(np.deg2rad(azimuth_deg))
    phi_i = min(max(phi_i, -0.416), 0.416)
    lam_i = lon_deg / 180 + psi * np.sin(np.deg2rad(azimuth_deg)) / np.cos(phi_i * np.pi)
    phi_m = phi_i + 0.064 * np.cos((lam_i - 1.617) * np.pi)
    t = (4.32e4 * lam_i + tow) % 86400
    f = 1 + 16 * (0.53 - e) ** 3
    period = max(sum(b * phi_m**n for n, b in enumerate(beta)), 72000)
    amplitude = max(sum(a * phi_m**n for n, a in enumerate(alpha)), 0)
    x = 2 * np.pi * (t - 50400) / period
    seconds = f * 5e-9 if abs(x) >= 1.57 else f * (5e-9 + amplitude * (1 - x**2 / 2 + x**4 / 24))
    return float(seconds * 299792458)


def grid() -> np.ndarray:
    """Return latitude, longitude, elevation, azimuth (degrees) and seconds of week, drawn."""
    rng = np.random.default_rng(5)
    low = [-80, -180, 3, -180, 0]
    return rng.uniform(low, [80, 180, 90, 180, 604800], size=(200, 5))


def klobuchar(places: np.ndarray) -> Tensor:
    degrees = torch.tensor(np.deg2rad(places[:, :4])).unbind(-1)
    return klobuchar_delay(*degrees, torch.tensor(places[:, 4]), tensor(*STUTTGART_2023))


def test_klobuchar_against_a_second_transcription() -> None:
    places = grid()
    expected = [klobuchar_in_degrees(*place) for place in places]
    np.testing.assert_allclose(klobuchar(places).numpy(), expected, rtol=1e-12)
    assert np.ptp(expected) > 10.0


def rtklib() -> Any:
    return pytest.importorskip("pyrtklib")


def doubles(values: Any) -> Any:
    library = rtklib()
    array = library.Arr1Ddouble(len(values))
    for k, value in enumerate(values):
        array[k] = float(value)
    return array


def test_klobuchar_against_rtklib() -> None:
    library = rtklib()
    places = grid()
    expected = [
        library.ionmodel(
            library.gpst2time(2268, float(tow)),
            doubles(STUTTGART_2023),
            doubles([*np.deg2rad([lat, lon]), 300.0]),
            doubles(np.deg2rad([azimuth, elevation])),
        )
        for lat, lon, elevation, azimuth, tow in places
    ]
    np.testing.assert_allclose(klobuchar(places).numpy(), expected, rtol=1e-9)


def test_at_night_five_nanoseconds_remain() -> None:
    # the layer above Greenwich at two in the morning; straight up the slant factor is 1.000432
    delay = klobuchar_delay(
        tensor(0.9), tensor(0.0), tensor(math.pi / 2), tensor(0.0), tensor(7200.0),
        tensor(*STUTTGART_2023),
    )  # fmt: skip
    assert float(delay) == pytest.approx(5e-9 * 1.000432 * 299792458.0, rel=1e-12)


def test_weeks_do_not_matter_to_the_ionosphere() -> None:
    places = grid()
    later = places + np.array([0, 0, 0, 0, 2268 * 604800])
    torch.testing.assert_close(klobuchar(later), klobuchar(places), atol=1e-6, rtol=0.0)


def test_below_the_horizon_as_on_it() -> None:
    lat, lon, azimuth, t = tensor(0.9), tensor(0.1), tensor(1.0), tensor(43200.0)
    elevation = tensor(0.0, -0.3, -0.346, -1.5)
    delay = klobuchar_delay(lat, lon, elevation, azimuth, t, tensor(*STUTTGART_2023))
    torch.testing.assert_close(delay, delay[:1].expand(4))
    delay = saastamoinen_delay(lat, tensor(0.0), elevation)
    torch.testing.assert_close(delay, delay[:1].expand(4))
    assert torch.isfinite(delay).all()


def test_other_carriers() -> None:
    delay = tensor(1.0, 8.0)
    torch.testing.assert_close(signals.delay_on_carrier(delay, signals.L1), delay)
    # GPS L2 sees (77/60)² of the delay on L1
    on_l2 = signals.delay_on_carrier(delay, tensor(1227.6e6, 1227.6e6))
    torch.testing.assert_close(on_l2, delay * (77 / 60) ** 2)


def test_zenith_delays_of_the_standard_atmosphere() -> None:
    # at 45 degrees and sea level the hydrostatic delay is 2.2768 mm per hPa
    hydrostatic, wet = zenith_delays(tensor(math.pi / 4), tensor(0.0))
    assert float(hydrostatic) == pytest.approx(2.2768e-3 * 1013.25, rel=1e-9)
    # 0.002277 (1255 K / T + 0.05) e with half of 17.0 hPa, what saturated air at 15 °C holds
    assert float(wet) == pytest.approx(0.002277 * (1255 / 288.15 + 0.05) * 8.52, rel=1e-2)
    assert float(zenith_delays(tensor(0.7), tensor(0.0), 0.0)[1]) == 0.0
    # half of the air lies below 5.5 km
    halved = zenith_delays(tensor(math.pi / 4), tensor(5500.0))[0] / hydrostatic
    assert float(halved) == pytest.approx(0.5, abs=0.005)


@pytest.mark.parametrize("height", [-6.4e6, -1000.0, 0.0, 9000.0, 44000.0, 2e7])
def test_any_height_has_a_finite_delay(height: float) -> None:
    at = tensor(height).requires_grad_()
    delay = saastamoinen_delay(tensor(0.8), at, tensor(0.3))
    (slope,) = torch.autograd.grad(delay, at)
    assert torch.isfinite(delay)
    assert torch.isfinite(slope)
    assert 0.0 < float(delay.detach()) < 15.0


def test_troposphere_against_rtklib() -> None:
    library = rtklib()
    time = library.gpst2time(2268, 385980.0)
    for height in (0.0, 330.0, 2000.0):
        for elevation_deg, within in ((90.0, 1e-3), (60.0, 2e-3), (30.0, 5e-3), (15.0, 2e-2)):
            elevation = math.radians(elevation_deg)
            expected = library.tropmodel(
                time, doubles([0.85, 0.16, height]), doubles([0.0, elevation]), 0.5
            )
            delay = float(saastamoinen_delay(tensor(0.85), tensor(height), tensor(elevation)))
            # there the slant is 1/sin, which is too long by 1.5 % at 15 degrees
            assert delay == pytest.approx(expected, rel=within + 3e-2 * (height > 1000.0))


def test_slant_factor_against_niell() -> None:
    library = rtklib()
    time = library.gpst2time(2268, 385980.0)
    for elevation_deg in (5.0, 7.0, 10.0, 15.0, 30.0, 60.0, 90.0):
        elevation = math.radians(elevation_deg)
        wet = library.Arr1Ddouble(1)
        niell = library.tropmapf(time, doubles([0.85, 0.16, 0.0]), doubles([0.0, elevation]), wet)
        assert float(slant_factor(tensor(elevation))) == pytest.approx(niell, rel=0.011)


def test_gradients() -> None:
    places = torch.tensor(np.deg2rad(grid()[:6, :4])).unbind(-1)
    inputs = [part.clone().requires_grad_() for part in places]
    t = torch.tensor(grid()[:6, 4])

    def ionosphere(*parts: Tensor) -> Tensor:
        return klobuchar_delay(*parts, t, tensor(*STUTTGART_2023))

    assert torch.autograd.gradcheck(ionosphere, inputs, eps=1e-7, atol=1e-5, rtol=1e-4)

    def troposphere(lat: Tensor, elevation: Tensor) -> Tensor:
        return saastamoinen_delay(lat, 1e3 * torch.ones_like(lat), elevation)

    assert torch.autograd.gradcheck(troposphere, (inputs[0], inputs[2]), eps=1e-7, atol=1e-5)
