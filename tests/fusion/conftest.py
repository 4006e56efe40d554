"""A small car of our own: truth by the sequential mechanization's parallel twin, noise by torch."""

import math
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.frames import shift_geodetic
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, Trajectory


class Drive(NamedTuple):
    start: NavState
    truth: Trajectory
    samples: RissSample
    fixes: GnssFix
    timing: FixTiming


def drive(
    seconds: int = 40,
    rate: int = 20,
    batch: int = 1,
    seed: int = 0,
    bias: float | Tensor = 0.002,
    scale: float | Tensor = 0.02,
    pitch_bias: float | Tensor = 0.01,
    gyro_random_walk: float = 2e-4,
    position_sigma: float = 1.0,
    velocity_sigma: float = 0.1,
) -> Drive:
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    length, dt = seconds * rate, 1.0 / rate
    t = torch.arange(1, length + 1, dtype=torch.float64) * dt
    phase = 6.28 * torch.rand(batch, 3, 1, generator=g, dtype=torch.float64)

    def speed_at(time: Tensor) -> Tensor:
        """Four seconds to stop, four of standing, four to be off again, every 25."""
        u = time % 25
        ramp = torch.where(u < 22, torch.minimum(20 - u, u + 1), u - 24) / 4
        return ramp.clamp(0, 1) * (12.0 + 8.0 * torch.sin(0.13 * time + phase[:, 0]))

    # samples are means over intervals, fixes are of the instant at which intervals end
    speed = speed_at(t - 0.5 * dt)
    rate_of_turn = 0.15 * torch.sin(0.2 * t + phase[:, 1]) + 0.05 * torch.sin(0.9 * t)
    rate_of_turn = torch.where(speed > 0, rate_of_turn, 0.0)
    pitch = 0.03 * torch.sin(0.12 * t + phase[:, 2])
    roll = 0.02 * torch.cos(0.17 * t + phase[:, 0])
    zero = torch.zeros(batch, length, dtype=torch.float64)
    lat = torch.full((batch,), 0.77, dtype=torch.float64)
    start = NavState(lat, -1.33 + 0.0 * lat, 100.0 + 0.0 * lat, 0.5 + 0.0 * lat)
    earth = wgs84.EARTH_RATE * torch.sin(lat)[:, None]
    still = (speed == 0).to(zero)
    clean = RissSample(zero + dt, rate_of_turn + earth, speed, pitch, roll, zero, zero, still)
    truth = riss_over_time(start, clean)
    gyro = clean.yaw_rate + bias + gyro_random_walk / math.sqrt(dt) * normal(batch, length)
    samples = clean._replace(yaw_rate=gyro, speed=speed * (1.0 + scale), pitch=pitch + pitch_bias)
    index = torch.arange(rate - 1, length, rate).expand(batch, -1).contiguous()
    at = Trajectory(*(torch.gather(x.expand(batch, -1), 1, index) for x in truth))
    shape = index.shape
    shift = (position_sigma * normal(*shape) for _ in range(3))
    lat, lon, height = shift_geodetic(at.lat, at.lon, at.height, *shift)
    one = torch.ones(shape, dtype=torch.float64)
    fast, slope = (torch.gather(x.expand(batch, -1), 1, index) for x in (speed_at(t), pitch))
    ahead = fast * torch.cos(slope)
    v = [ahead * torch.sin(at.azimuth), ahead * torch.cos(at.azimuth), fast * torch.sin(slope)]
    v = [x + velocity_sigma * normal(*shape) for x in v]
    sigma = position_sigma * one
    fixes = GnssFix(lat, lon, height, *v, sigma, sigma, sigma, velocity_sigma * one, one, one)
    return Drive(start, truth, samples, fixes, FixTiming(index, 0.0 * one))


@pytest.fixture(scope="session")
def make_drive() -> Callable[..., Drive]:
    return drive
