"""A winding, hilly drive whose batches differ, for the tests of this room."""

import math

import pytest
import torch

from navlearn.states import NavState, RissSample


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
