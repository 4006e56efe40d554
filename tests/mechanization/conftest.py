"""Winding, hilly drives whose batches differ, for the tests of this room."""

import math

import pytest
import torch

from navlearn import attitude, earth, wgs84
from navlearn.states import ImuSample, InsState, NavState, RissSample


@pytest.fixture
def start():
    """Return a maker of starts, one per record."""

    def make(records: int) -> NavState:
        k = torch.arange(records, dtype=torch.float64)
        return NavState(0.77 - 0.3 * k, -1.3 + k, 100.0 + 50.0 * k, 0.7 - 2.0 * k)

    return make


@pytest.fixture
def drive():
    """Return a maker of samples of shape (records, length)."""

    def make(records: int, length: int, dt: float = 0.01) -> RissSample:
        t = torch.arange(length, dtype=torch.float64) * dt
        phase = torch.arange(records, dtype=torch.float64).unsqueeze(-1)
        zero = torch.zeros(records, length, dtype=torch.float64)
        return RissSample(
            dt=zero + dt,
            yaw_rate=0.15 * torch.sin(2.0 * math.pi * t / 40.0 + phase) + 0.01,
            speed=15.0 + 12.0 * torch.sin(2.0 * math.pi * t / 97.0 + 2.0 * phase),
            pitch=0.06 * torch.sin(t / 30.0 + phase),
            roll=0.04 * torch.cos(t / 11.0 + phase),
            f_x=zero,
            f_y=zero,
            stationary=zero,
        )

    return make


@pytest.fixture
def ins_start():
    """Return a maker of starts for a full IMU, one per record."""

    def make(records: int) -> InsState:
        k = torch.arange(records, dtype=torch.float64)
        v_l = torch.stack((12.0 - 5.0 * k, 9.0 + k, 0.3 - 0.1 * k), -1)
        q_lb = attitude.quaternion_from_angles(0.9 - 2.0 * k, 0.05 - 0.03 * k, 0.02 * k - 0.03)
        return InsState(0.77 - 0.3 * k, -1.3 + k, 100.0 + 50.0 * k, v_l, q_lb)

    return make


@pytest.fixture
def imu_drive():
    """Return a maker of the samples of a full IMU, of shape (records, length)."""

    def make(records: int, length: int, dt: float = 0.01) -> ImuSample:
        t = torch.arange(length, dtype=torch.float64) * dt
        phase = torch.arange(records, dtype=torch.float64).unsqueeze(-1)
        zero = torch.zeros(records, length, dtype=torch.float64)
        omega = (0.03 * torch.sin(0.9 * t + phase), 0.02 * torch.cos(1.3 * t), 0.2 * torch.sin(t))
        force = (torch.sin(0.4 * t), torch.cos(0.21 * t + phase), 9.8 + 0.5 * torch.sin(3.0 * t))
        vectors = (torch.stack([zero + x for x in axes], -1) for axes in (omega, force))
        return ImuSample(zero + dt, *vectors, zero, zero, zero)

    return make


@pytest.fixture
def parked():
    """Return a maker of starts and samples of cars that stand on the turning Earth."""

    def make(length: int, dt: float) -> tuple[InsState, ImuSample]:
        lat = torch.tensor((-1.1, 0.0, 0.4, 1.2), dtype=torch.float64)
        height = torch.tensor((0.0, 3000.0, 90.0, -100.0), dtype=torch.float64)
        angles = torch.tensor(((0.3, 0.1, 0.2), (2.0, -0.2, 0.1), (-1.0, 0.3, -0.3), (4.0, 0, 0)))
        C_lb = attitude.matrix_from_angles(*angles.double().unbind(-1))
        q_lb = attitude.quaternion_from_angles(*angles.double().unbind(-1))
        start = InsState(lat, 0.0 * lat + 2.0, height, torch.zeros(4, 3).double(), q_lb)
        omega = torch.stack((0.0 * lat, torch.cos(lat), torch.sin(lat)), -1) * wgs84.EARTH_RATE
        up = torch.tensor((0.0, 0.0, 1.0), dtype=torch.float64)
        force = earth.normal_gravity(lat, height).unsqueeze(-1) * up
        means = ((C_lb.transpose(-1, -2) @ x.unsqueeze(-1)).squeeze(-1) for x in (omega, force))
        zero = torch.zeros(4, length, dtype=torch.float64)
        held = (x.unsqueeze(-2).expand(4, length, 3) for x in means)
        return start, ImuSample(zero + dt, *held, zero, zero, zero)

    return make
