"""What is given to both filters: drives, fixes, a start that is off, and what they are told."""

import math
from typing import NamedTuple

import numpy as np
import torch

from beside_pyins.frames import drive, imu_sample, states_of
from navlearn.frames import shift_geodetic
from navlearn.fusion.ins.layout import moved_state
from navlearn.states import GnssFix, ImuSample, InsState

LEVER_ARM = (0.4, -0.5, 0.9)
OUTAGE = 60
DEG_PER_H = math.radians(1.0) / 3600.0


class Told(NamedTuple):
    """What both filters are told about the sensors and the start; SI units and radians.

    Attributes:
        gyro: Angle random walk, rad/√s.
        accel: Velocity random walk, m/s/√s.
        gyro_walk: Random walk of the gyro biases, rad/s/√s.
        accel_walk: Random walk of the accelerometer biases, m/s²/√s.
        gyro_bias: Deviation of the gyro biases at the start, rad/s.
        accel_bias: Deviation of the accelerometer biases at the start, m/s².
        tilt: Deviation of pitch and roll at the start, rad.
        azimuth: Deviation of the azimuth at the start, rad.
        position: Deviation of the position at the start, m.
        velocity: Deviation of the velocity at the start, m/s.
    """

    gyro: float
    accel: float
    gyro_walk: float
    accel_walk: float
    gyro_bias: float
    accel_bias: float
    tilt: float = math.radians(0.3)
    azimuth: float = math.radians(2.0)
    position: float = 2.0
    velocity: float = 0.1

    @property
    def sigmas(self):
        """Deviations of the 15 errors at the start."""
        groups = (self.position, self.velocity, None, self.gyro_bias, self.accel_bias)
        attitude = [self.tilt, self.tilt, self.azimuth]
        listed = [attitude if sigma is None else [sigma] * 3 for sigma in groups]
        return torch.tensor([s for group in listed for s in group], dtype=torch.float64)


TOLD = {
    "mems_m": Told(
        gyro=math.radians(1.2) / 60.0,
        accel=0.01,
        gyro_walk=2.0 * DEG_PER_H,
        accel_walk=3e-4,
        gyro_bias=math.radians(0.25),
        accel_bias=0.1,
    ),
    "tactical": Told(
        gyro=math.radians(0.12) / 60.0,
        accel=1e-3,
        gyro_walk=0.03 * DEG_PER_H,
        accel_walk=3e-5,
        gyro_bias=3.0 * DEG_PER_H,
        accel_bias=0.006,
        tilt=math.radians(0.1),
        azimuth=math.radians(1.0),
    ),
}
"""Above the data sheet of each grade, for what is no state: scale factors and the like."""

HONEST = Told(
    gyro=math.radians(0.6) / 60.0,
    accel=2e-3,
    gyro_walk=2.0 * DEG_PER_H,
    accel_walk=1e-4,
    gyro_bias=math.radians(0.2),
    accel_bias=0.05,
)
"""The very noise of the drives that :func:`drawn` makes."""


class Work(NamedTuple):
    """What is given to a filter: B drives of T samples with M fixes at the same samples.

    Attributes:
        start: Believed state at t = 0, shape (B,).
        samples: Samples, shape (B, T).
        fixes: Fixes, shape (B, M).
        index: The fixes fall at the ends of these samples, shape (M,).
        truth: True state at the end of every sample, shape (T,).
        bias: True biases, gyros then accelerometers, shape (B, T, 6); None where not known.
        told: What the filters are told.
    """

    start: InsState
    samples: ImuSample
    fixes: GnssFix
    index: torch.Tensor
    truth: InsState
    bias: torch.Tensor | None
    told: Told


def _believed(truth, told, batch, seed):
    """Return starts that miss the truth as far as the filters are told, shape (B,)."""
    random = torch.Generator().manual_seed(seed)
    errors = torch.randn(batch, 15, generator=random, dtype=torch.float64) * told.sigmas
    first = InsState(*(x[:1].expand(batch, *x.shape[1:]) for x in truth))
    return moved_state(first, errors)


def _fixes(log, outages):
    """Return the fixes outside outages, shape (1, M), and where they fall among the samples."""
    table = log.fixes[log.fixes["t"] > 0.5]
    for begin in outages:
        table = table[(table["t"] < begin) | (table["t"] >= begin + OUTAGE)]
    one = torch.ones(1, len(table), dtype=torch.float64)
    values = (torch.tensor(table[name].to_numpy())[None] for name in GnssFix._fields[:10])
    index = torch.tensor(np.searchsorted(log.imu["t"], table["t"] - 1e-6))
    return GnssFix(*values, one, one), index


def simulated(grade, seed, seconds, outages):
    """Return one simulated drive of a sensor grade, with errors that 15 states do not know."""
    log = drive(seconds, seed, grade, lever_arm=LEVER_ARM).log
    truth, told = states_of(log.reference), TOLD[grade]
    ends = InsState(*(x[1:] for x in truth))
    start = _believed(truth, told, 1, seed)
    return Work(start, imu_sample(log.imu), *_fixes(log, outages), ends, None, told)


def drawn(runs, seconds, outages, rate=50.0, seed=11):
    """Return one drive many times over, its noise just what the filters are told."""
    log = drive(seconds, seed, rate=rate, lever_arm=LEVER_ARM, standstill=5.0).log
    truth, clean = states_of(log.reference), imu_sample(log.imu)
    random = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(runs, *shape, generator=random, dtype=torch.float64)

    def triads(gyro, accel):
        return torch.tensor([gyro] * 3 + [accel] * 3, dtype=torch.float64)

    count, root = clean.dt.shape[-1], math.sqrt(1.0 / rate)
    walk = triads(HONEST.gyro_walk, HONEST.accel_walk) * root
    bias = triads(HONEST.gyro_bias, HONEST.accel_bias) * normal(1, 6)
    bias = bias + (walk * normal(count, 6)).cumsum(1)
    read = torch.cat((clean.omega_ib_b, clean.f_b), -1) + bias
    read = read + triads(HONEST.gyro, HONEST.accel) / root * normal(count, 6)
    samples = ImuSample(*(x.expand(runs, *x.shape[1:]) for x in clean))
    samples = samples._replace(omega_ib_b=read[..., :3], f_b=read[..., 3:])
    exact, index = _fixes(log, outages)
    at = GnssFix(*(x.expand(runs, -1) for x in exact))
    place = shift_geodetic(*at[:3], *(1.5 * normal(len(index), 3)).unbind(-1))
    v = [x + 0.1 * normal(len(index)) for x in at[3:6]]
    sigma = torch.full_like(at.lat, 1.5)
    fixes = GnssFix(*place, *v, sigma, sigma, sigma, sigma / 15.0, *at[10:])
    ends = InsState(*(x[1:] for x in truth))
    start = _believed(truth, HONEST, runs, seed)
    return Work(start, samples, fixes, index, ends, bias, HONEST)
