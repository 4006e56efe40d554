"""Regressors of a coasting navigator: values, and what they must not depend on."""

import math

import pytest
import torch

from navlearn import attitude
from navlearn.errors import ConfigError
from navlearn.learning.ins_regressors import INS_CHANNELS, coast_means, ins_regressors
from navlearn.states import InsState

NAMES = tuple(INS_CHANNELS)


def driving(azimuth=0.7, pitch=0.05, roll=-0.02, speed=12.0, lat=0.8, length=20):
    """Return a coast straight ahead, with a constant turn told by the gyro."""
    full = torch.full((length,), 1.0, dtype=torch.float64)
    angles = [angle * full for angle in (azimuth, pitch, roll)]
    q = attitude.quaternion_from_angles(*angles)
    c_lb = attitude.matrix_from_quaternion(q)
    coast = InsState(lat * full, 0.1 * full, 0.0 * full, speed * c_lb[..., 1], q)
    omega = torch.tensor((0.01, -0.02, 0.1), dtype=torch.float64) * full.unsqueeze(-1)
    force_b = torch.tensor((0.3, 0.5, 0.0), dtype=torch.float64) + 9.80665 * c_lb[..., 2, :]
    return coast, 0.1 * full, omega, force_b


def test_values_of_every_channel():
    u = ins_regressors(coast_means(*driving(), 10), NAMES)
    assert u.shape == (2, len(NAMES))
    found = dict(zip(NAMES, u[1].tolist(), strict=True))
    wanted = {
        "forward_speed": 12.0, "lateral_speed": 0.0, "vertical_speed": 0.0,
        "forward_acceleration": 0.5, "lateral_acceleration": 0.3, "vertical_acceleration": 0.0,
        "pitch_rate": 0.01, "roll_rate": -0.02, "yaw_rate": 0.1, "abs_yaw_rate": 0.1,
        "turned_angle": 0.2, "pitch": 0.05, "roll": -0.02, "delay": 2.0 / 60.0,
        "turned_speed": 2.4, "delayed_speed": 0.4,
    }  # fmt: skip
    assert found == pytest.approx(wanted, abs=1e-9)


def test_channels_do_not_tell_where_in_the_world_or_which_way():
    here = ins_regressors(coast_means(*driving(), 5), NAMES)
    there = ins_regressors(coast_means(*driving(azimuth=-2.9, lat=-0.3), 5), NAMES)
    assert torch.allclose(here, there, atol=1e-9)


def test_rows_depend_on_the_past_only():
    coast, dt, omega, force = driving()
    whole = ins_regressors(coast_means(coast, dt, omega, force, 5), NAMES)
    cut = InsState(*(channel[:10] for channel in coast))
    part = ins_regressors(coast_means(cut, dt[:10], omega[:10], force[:10], 5), NAMES)
    assert torch.allclose(whole[:2], part, atol=1e-12)


def test_what_cannot_be_used_is_refused():
    with pytest.raises(ConfigError, match="no whole steps of 7"):
        coast_means(*driving(), 7)
    means = coast_means(*driving(), 10)
    assert math.isclose(float(means.dt[0]), 1.0)
    with pytest.raises(ConfigError, match="latitude"):
        ins_regressors(means, ("latitude",))
