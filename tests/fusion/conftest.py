"""A small car of our own: truth by the sequential mechanization's parallel twin, noise by torch."""

import math
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.filters.belief import Belief
from navlearn.frames import shift_geodetic
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.noise_options import InitialOptions, NoiseOptions
from navlearn.fusion.options import EkfOptions
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


def drives_of_the_model(
    runs: int, seconds: int, seed: int
) -> tuple[EkfOptions, Belief, Drive, Tensor]:
    """A filter, what it believes at the start, drives whose errors are drawn from its own model,
    and their sensor errors, shape (runs, 1, 3)."""
    initial = InitialOptions(
        position=2.0,
        height=2.0,
        azimuth=0.03,
        pitch_bias=0.005,
        gyro={"bias": 0.001},
        speed={"scale": 0.01},
    )
    noise = NoiseOptions(
        gyro_random_walk=5e-4,
        turn_noise=0.0,
        gyro_bias_walk=1e-7,
        speed_scale_walk=1e-7,
        pitch_bias_walk=1e-7,
        position_walk=1e-3,
        height_walk=1e-3,
        hill_walk=1e-3,
        position_inflation=1.0,
        position_floor=0.0,
        height_floor=0.0,
        velocity_floor=0.0,
        speed_noise=0.0,
    )
    options = EkfOptions(
        initial=initial, noise=noise, gate=GateOptions(probability=1.0), zero_yaw_rate=False
    )
    g = torch.Generator().manual_seed(seed)

    def draw(sigma: float) -> Tensor:
        return sigma * torch.randn(runs, 1, generator=g, dtype=torch.float64)

    bias, scale, pitch = draw(0.001), draw(0.01), draw(0.005)
    d = drive(
        seconds=seconds,
        rate=10,
        batch=runs,
        seed=seed - 6,
        bias=bias,
        scale=scale,
        pitch_bias=pitch,
        gyro_random_walk=5e-4,
    )
    still = torch.zeros_like(d.samples.stationary)
    d = d._replace(samples=d.samples._replace(stationary=still))
    wrong = torch.cat((draw(2.0), draw(2.0), draw(2.0), draw(0.03)), 1)
    lat, lon, height = shift_geodetic(*d.start[:3], *wrong[:, :3].unbind(1))
    begin = NavState(lat, lon, height, d.start.azimuth + wrong[:, 3])
    belief = initial_belief(options, d.start)._replace(state=begin)
    return options, belief, d, torch.cat((bias, scale, pitch), 1).unsqueeze(1)


@pytest.fixture(scope="session")
def model_drives() -> Callable[..., tuple[EkfOptions, Belief, Drive, Tensor]]:
    return drives_of_the_model
