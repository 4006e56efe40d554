"""A car of our own with six axes: truth and error-free sensors by the simulator, noise by torch."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.attitude import quaternion_from_angles
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.frames import shift_geodetic
from navlearn.fusion.ins.layout import ins_layout, moved_state
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.logs.synthetic import simulate_drive
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

LEVER_ARM = (0.4, -0.8, 1.3)


class InsDrive(NamedTuple):
    """Shape (T,) or (M,) each without batch, (B, T) or (B, M) with one."""

    start: InsState
    truth: InsState
    samples: ImuSample
    fixes: GnssFix
    timing: FixTiming


def tensor(values: object) -> Tensor:
    return torch.tensor(np.asarray(values, dtype=np.float64))


def state_of(table: dict[str, np.ndarray]) -> InsState:
    velocity = torch.stack([tensor(table[k]) for k in ("v_e", "v_n", "v_u")], -1)
    angles = (tensor(table[k]) for k in ("azimuth", "pitch", "roll"))
    where = (tensor(table[k]) for k in ("lat", "lon", "height"))
    return InsState(*where, velocity, quaternion_from_angles(*angles))


@lru_cache(maxsize=8)
def clean_drive(
    seconds: float = 40.0, rate: int = 50, profile: str = "town", stands: float = 5.0
) -> InsDrive:
    """A drive without sensor errors; antenna at ``LEVER_ARM``, a fix per second."""
    drive = simulate_drive(
        profile=profile,
        grade="ideal",
        duration=seconds,
        seed=11,
        imu_rate_hz=rate,
        reference_rate_hz=rate,
        standstill=stands,
        lever_arm=LEVER_ARM,
    )
    imu, reference = drive.log.imu, drive.log.reference
    t = imu["t"].to_numpy()
    at = reference["t"].to_numpy()
    table = {c: np.asarray(reference[c]) for c in reference.columns}
    table["azimuth"] = np.unwrap(table["azimuth"])
    truth = state_of({c: np.interp(t, at, table[c]) for c in table})
    start = state_of({c: table[c][0] for c in table})
    one = torch.ones(len(t), dtype=torch.float64)
    fast = torch.linalg.vector_norm(torch.cat((start.v_l[None], truth.v_l)), dim=-1)
    omega = tensor(imu[["gyro_x", "gyro_y", "gyro_z"]])
    force = tensor(imu[["accel_x", "accel_y", "accel_z"]])
    still = ((fast[1:] < 1e-9) & (fast[:-1] < 1e-9)).to(one)
    speed = 0.5 * (fast[1:] + fast[:-1])
    samples = ImuSample(one / rate, omega, force, speed, one, still)
    table = drive.log.fixes
    inside = (table["t"] > 0.0) & (table["t"] <= t[-1] + 1e-9)
    stamps = table["t"][inside].to_numpy()
    index = torch.from_numpy(np.rint(stamps * rate).astype(np.int64) - 1)
    names = ("lat", "lon", "height", "v_e", "v_n", "v_u")
    solution = [tensor(table[name][inside]) for name in names]
    each = torch.ones(len(stamps), dtype=torch.float64)
    fixes = GnssFix(*solution, each, each, each, 0.1 * each, each, each)
    return InsDrive(start, truth, samples, fixes, FixTiming(index, 0.0 * each))


def noisy_fixes(fixes: GnssFix, g: torch.Generator, sigma: float, sigma_v: float) -> GnssFix:
    """Give fixes white noise of their stated deviations."""

    def normal(like: Tensor) -> Tensor:
        return torch.randn(like.shape, generator=g, dtype=torch.float64)

    moved = shift_geodetic(*fixes[:3], *(sigma * normal(fixes.lat) for _ in range(3)))
    speeds = (v + sigma_v * normal(v) for v in fixes[3:6])
    one = torch.ones_like(fixes.lat)
    return GnssFix(*moved, *speeds, *(sigma * one,) * 3, sigma_v * one, *fixes[10:])


def batch_of(drive: InsDrive, runs: int) -> InsDrive:
    """Repeat a drive along a batch axis."""
    return InsDrive(
        *(type(part)(*(x.expand(runs, *x.shape).clone() for x in part)) for part in drive)
    )


class ModelDrives(NamedTuple):
    """Drives whose errors are drawn from the filter's own model, what it believes, the truth."""

    belief: InsBelief
    drive: InsDrive
    sensors: Tensor


def drives_of_the_model(
    options: InsEkfOptions, runs: int, seed: int, clean: InsDrive
) -> ModelDrives:
    """Draw initial errors, sensor errors, white noise and fixes as the options state them."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    d = batch_of(clean, runs)
    layout, noise = ins_layout(options), options.noise
    belief = initial_ins_belief(options, d.start)
    wrong = belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt() * normal(runs, layout.size)
    sensors = -wrong[:, 9:]  # believed to be zero
    gyro, accel = 1.0, 1.0
    samples = d.samples
    dt = float(samples.dt[0, 0])
    bias_g, bias_a = sensors[:, None, 0:3], sensors[:, None, 3:6]
    if layout.has_scale:
        gyro, accel = 1.0 + sensors[:, None, 6:9], 1.0 + sensors[:, None, 9:12]
    shape = samples.omega_ib_b.shape
    samples = samples._replace(
        omega_ib_b=gyro * samples.omega_ib_b
        + bias_g
        + noise.gyro_random_walk / math.sqrt(dt) * normal(*shape),
        f_b=accel * samples.f_b + bias_a + noise.accel_random_walk / math.sqrt(dt) * normal(*shape),
    )
    if layout.odometer_scale:
        speed = (1.0 + sensors[:, -1:]) * samples.speed
        samples = samples._replace(speed=speed + noise.odometer_noise * normal(*speed.shape))
    fixes = noisy_fixes(d.fixes, g, 1.0, 0.1)
    belief = belief._replace(state=moved_state(d.start, wrong))
    return ModelDrives(belief, d._replace(samples=samples, fixes=fixes), sensors)


@pytest.fixture(scope="session")
def make_clean() -> Callable[..., InsDrive]:
    return clean_drive


@pytest.fixture(scope="session")
def make_drive() -> Callable[..., InsDrive]:
    """A noisy drive with biases, without batch axis."""

    def make(seconds: float = 40.0, rate: int = 50, seed: int = 1) -> InsDrive:
        d = clean_drive(seconds, rate)
        g = torch.Generator().manual_seed(seed)
        samples = d.samples._replace(
            omega_ib_b=d.samples.omega_ib_b + torch.tensor([0.001, -0.002, 0.0015]).double(),
            f_b=d.samples.f_b + torch.tensor([0.02, -0.03, 0.04]).double(),
            speed=1.01 * d.samples.speed,
        )
        return d._replace(samples=samples, fixes=noisy_fixes(d.fixes, g, 1.0, 0.1))

    return make


@pytest.fixture(scope="session")
def model_drives() -> Callable[..., ModelDrives]:
    return drives_of_the_model


@pytest.fixture(scope="session")
def lever_arm() -> tuple[float, float, float]:
    return LEVER_ARM


def unsqueezed(belief: InsBelief) -> InsBelief:
    return map_ins_belief(belief, lambda x: x.unsqueeze(0))
