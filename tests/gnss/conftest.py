"""Satellites over a car: ranges without error from a place that is known."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn import frames
from navlearn.gnss.range_noise import RangeNoiseOptions, range_noise, range_variance
from navlearn.gnss.single_point import SinglePoint
from navlearn.states import SatelliteRanges

LAT, LON, HEIGHT = math.radians(44.23), math.radians(-76.48), 75.0
ORBIT = 2.656e7


@dataclass(frozen=True, kw_only=True)
class Sky:
    """Ranges of receptions to satellites, and what they came from."""

    ranges: SatelliteRanges
    lat: Tensor
    lon: Tensor
    height: Tensor
    clock: Tensor
    velocity: Tensor
    drift: Tensor
    unit: Tensor

    def errors(self, found: SinglePoint) -> Tensor:
        """Return position errors east, north, up, m, shape (M, 3)."""
        place = (found.lat, found.lon, found.height)
        enu = frames.enu_between(*place, self.lat, self.lon, self.height)
        return torch.stack(enu, dim=-1)

    def noisy(self, seed: int = 1) -> SatelliteRanges:
        """Return the ranges with errors as the default noise has them."""
        ranges = self.ranges
        noise = range_noise(RangeNoiseOptions())
        deviation = range_variance(noise, ranges.elevation, ranges.cn0, ranges.std_range).sqrt()
        draw = torch.Generator().manual_seed(seed)
        error = deviation * torch.randn(deviation.shape, generator=draw, dtype=torch.float64)
        return ranges._replace(pseudorange=ranges.pseudorange + error)


def _sky(*, receptions: int = 5, satellites: int = 9, systems: int = 1, seed: int = 1) -> Sky:
    """Return noise-free ranges to satellites on one sphere, spread over the sky.

    Worked out in NumPy by straight geometry: satellites along drawn directions, ranges by
    Pythagoras, range rates by differences over a millisecond.
    """
    draw = np.random.default_rng(seed)
    m, s = receptions, satellites
    lat, lon = LAT + 1e-5 * draw.standard_normal(m), LON + 1e-5 * draw.standard_normal(m)
    height = HEIGHT + 5.0 * draw.standard_normal(m)
    car = frames.ecef_from_geodetic(*map(torch.tensor, (lat, lon, height))).numpy()
    turn = frames.enu_from_ecef_matrix(torch.tensor(lat), torch.tensor(lon)).numpy()
    elevation = np.radians(draw.uniform(15.0, 85.0, (m, s)))
    azimuth = 2.0 * math.pi * (np.arange(s) / s + draw.uniform(-0.03, 0.03, (m, s)))
    unit = np.stack(
        (
            np.cos(elevation) * np.sin(azimuth),
            np.cos(elevation) * np.cos(azimuth),
            np.sin(elevation),
        ),
        -1,
    )
    direction = np.einsum("mji,msj->msi", turn, unit)
    along = np.einsum("msi,mi->ms", direction, car)
    distance = -along + np.sqrt(along**2 + ORBIT**2 - (car**2).sum(-1)[:, None])
    satellite = car[:, None] + distance[..., None] * direction
    satellite_velocity = np.cross(satellite, draw.standard_normal((m, s, 3)))
    satellite_velocity *= 3000.0 / np.linalg.norm(satellite_velocity, axis=-1, keepdims=True)
    velocity = draw.uniform(-20.0, 20.0, (m, 3)) * np.array([1.0, 1.0, 0.05])
    velocity_ecef = np.einsum("mji,mj->mi", turn, velocity)
    clock = np.concatenate(
        (3e5 * draw.uniform(-1.0, 1.0, (m, 1)), 40.0 * draw.standard_normal((m, systems - 1))), -1
    )
    drift = 100.0 * draw.standard_normal(m)
    system = np.arange(s) % systems
    own_clock = clock[:, :1] + np.where(system > 0, clock[:, system], 0.0)

    def away(dt: float) -> np.ndarray:
        gap = satellite + dt * satellite_velocity - (car + dt * velocity_ecef)[:, None]
        return np.linalg.norm(gap, axis=-1)

    rate = (away(0.5e-3) - away(-0.5e-3)) / 1e-3 + drift[:, None]
    one = np.ones((m, s))
    ranges = SatelliteRanges(
        *(
            torch.tensor(value)
            for value in (
                *(satellite, satellite_velocity, away(0.0) + own_clock, rate, elevation),
                *(45.0 * one, 0.0 * one, 0.0 * one, system, one, one),
            )
        )
    )
    return Sky(
        ranges=ranges,
        lat=torch.tensor(lat),
        lon=torch.tensor(lon),
        height=torch.tensor(height),
        clock=torch.tensor(clock),
        velocity=torch.tensor(velocity),
        drift=torch.tensor(drift),
        unit=torch.tensor(unit),
    )


@pytest.fixture
def make_sky() -> Callable[..., Sky]:
    """Return what makes a sky."""
    return _sky
