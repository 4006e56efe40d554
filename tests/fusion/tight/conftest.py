"""Satellites of our own over a car: fixed or moving places, white errors as told."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.frames import ecef_from_geodetic, enu_between, enu_from_ecef_matrix
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.history import TightHistory
from navlearn.gnss.range_noise import (
    RangeNoiseOptions,
    range_noise,
    range_variance,
    rate_variance,
)
from navlearn.states import FixTiming, RissSample, SatelliteRanges, Trajectory

AZIMUTHS = (0.3, 1.4, 2.2, 3.1, 4.0, 4.9, 5.8, 0.9)
EXACT_NOISE = RangeNoiseOptions()
ELEVATIONS = (0.4, 1.2, 0.7, 0.35, 0.9, 0.5, 0.75, 0.3)


class Car(NamedTuple):
    """Where the antenna truly was at M receptions: shape (B, M) each, velocity (B, M, 3)."""

    lat: Tensor
    lon: Tensor
    height: Tensor
    velocity: Tensor


def received(
    car: Car,
    time: Tensor,
    clock: Tensor,
    drift: Tensor,
    satellites: int = 8,
    offsets: tuple[float, ...] = (0.0,),
    noise: RangeNoiseOptions | None = None,
    seed: int = 0,
) -> SatelliteRanges:
    """Ranges of satellites that drift slowly over the sky, with white errors of ``noise``.

    ``clock`` and ``drift`` of shape (B, M); satellite s is of system s mod len(offsets). Errors are
    drawn only where ``noise`` is given.
    """
    batch, count = car.lat.shape
    g = torch.Generator().manual_seed(seed)
    turn = enu_from_ecef_matrix(car.lat[:, :1], car.lon[:, :1])
    place = ecef_from_geodetic(car.lat, car.lon, car.height)
    azimuth = torch.tensor(AZIMUTHS[:satellites], dtype=torch.float64)
    elevation = torch.tensor(ELEVATIONS[:satellites], dtype=torch.float64)
    level = torch.cos(elevation)
    unit = torch.stack(
        (level * torch.sin(azimuth), level * torch.cos(azimuth), torch.sin(elevation)), -1
    )
    across = torch.stack((torch.cos(azimuth), -torch.sin(azimuth), 0.0 * azimuth), -1)
    speed = torch.linspace(500.0, 900.0, satellites, dtype=torch.float64).unsqueeze(-1)
    v = speed * (0.8 * across + 0.6 * unit)
    at = 2.2e7 * unit + v * time[..., None, None]
    satellite = place[:, :1].unsqueeze(2) + at @ turn
    velocity = (v @ turn).expand(satellite.shape)
    away = satellite - place.unsqueeze(2)
    distance = away.norm(dim=-1)
    sight = away / distance.unsqueeze(-1)
    own = (enu_from_ecef_matrix(car.lat, car.lon).mT @ car.velocity.unsqueeze(-1)).squeeze(-1)
    # in inertial axes, as the textbook has it: both are carried round by the Earth
    spin = torch.tensor([0.0, 0.0, 7.292115e-5], dtype=torch.float64)
    inertial = velocity + torch.linalg.cross(spin.expand_as(satellite), satellite)
    carried = own + torch.linalg.cross(spin.expand_as(place), place)
    along = (sight * (inertial - carried.unsqueeze(2))).sum(-1)
    rate = along / (1.0 + (sight * inertial).sum(-1) / 299792458.0)
    system = torch.arange(satellites) % len(offsets)
    behind = torch.tensor(offsets, dtype=torch.float64)[system]
    pseudorange = distance + clock.unsqueeze(-1) + behind
    range_rate = rate + drift.unsqueeze(-1)
    one = torch.ones(batch, count, satellites, dtype=torch.float64)
    high = elevation.expand(batch, count, satellites)
    if noise is not None:
        told = range_noise(noise)
        deviation = torch.sqrt(range_variance(told, high, 45.0 * one, 0.0 * one))
        pseudorange = pseudorange + deviation * torch.randn(
            one.shape, generator=g, dtype=torch.float64
        )
        deviation = torch.sqrt(rate_variance(told, high, 45.0 * one, 0.0 * one))
        range_rate = range_rate + deviation * torch.randn(
            one.shape, generator=g, dtype=torch.float64
        )
    return SatelliteRanges(
        satellite,
        velocity,
        pseudorange,
        range_rate,
        high.clone(),
        45.0 * one,
        0.0 * one,
        0.0 * one,
        system.expand(batch, count, satellites).clone(),
        one,
        one.clone(),
    )


def clock_of(time: Tensor, batch: int, seed: int = 0, bias: float = 5e4) -> tuple[Tensor, Tensor]:
    """Bias and drift at given moments, shape (B, M) each, walking as the default options say."""
    g = torch.Generator().manual_seed(seed + 1000)
    steps = torch.diff(time, prepend=time.new_zeros(1))
    drift, ahead = torch.full((batch,), 60.0, dtype=torch.float64), []
    here = torch.full((batch,), bias, dtype=torch.float64)
    rates = []
    for dt in steps.tolist():
        a, b, c = (torch.randn(batch, generator=g, dtype=torch.float64) for _ in range(3))
        walk = 0.2 * math.sqrt(dt) * a
        here = here + drift * dt + 0.5 * dt * walk + 0.2 * dt**1.5 / math.sqrt(12.0) * b
        here = here + 0.1 * math.sqrt(dt) * c
        drift = drift + walk
        ahead.append(here)
        rates.append(drift)
    return torch.stack(ahead, -1), torch.stack(rates, -1)


@pytest.fixture(scope="session")
def make_ranges() -> Callable[..., SatelliteRanges]:
    return received


@pytest.fixture(scope="session")
def make_clock() -> Callable[..., tuple[Tensor, Tensor]]:
    return clock_of


@pytest.fixture(scope="session")
def make_car() -> type[Car]:
    return Car


class RangeDrive(NamedTuple):
    """A RISS drive of the house's small car with ranges at its fixes, batch shape (B,).

    ``clock`` and ``drift`` are those of the receiver, shape (B, M).
    """

    options: EkfOptions
    start: Belief
    truth: Trajectory
    samples: RissSample
    ranges: SatelliteRanges
    timing: FixTiming
    clock: Tensor
    drift: Tensor


@pytest.fixture(scope="session")
def range_drive(make_drive: Callable[..., Any]) -> Callable[..., RangeDrive]:
    def make(
        seconds: int = 40,
        batch: int = 1,
        seed: int = 0,
        satellites: int = 8,
        offsets: tuple[float, ...] = (0.0, 120.0),
        noise: RangeNoiseOptions | None = EXACT_NOISE,
    ) -> RangeDrive:
        d = make_drive(seconds=seconds, batch=batch, seed=seed)
        options = EkfOptions(position=False, velocity=False)
        at = [torch.gather(x, 1, d.timing.index) for x in d.truth[:3]]
        true = make_drive(seconds=seconds, batch=batch, seed=seed, velocity_sigma=0.0).fixes
        velocity = torch.stack((true.v_e, true.v_n, true.v_u), -1)
        time = torch.arange(1, seconds + 1, dtype=torch.float64)
        clock, drift = clock_of(time, batch, seed)
        car = Car(*at, velocity)
        ranges = received(car, time, clock, drift, satellites, offsets, noise, seed)
        start = initial_belief(options, d.start)
        return RangeDrive(options, start, d.truth, d.samples, ranges, d.timing, clock, drift)

    return make


@pytest.fixture(scope="session")
def off() -> Callable[..., Tensor]:
    """How far a history's trajectory is from the truth, east, north, up, m, shape (B, T, 3)."""

    def found(history: TightHistory, truth: Trajectory) -> Tensor:
        return torch.stack(enu_between(*history.trajectory[:3], *truth[:3]), -1)

    return found


@pytest.fixture(scope="session")
def model_start() -> Callable[..., Belief]:
    return initial_belief
