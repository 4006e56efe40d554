"""Odometer and receiver: figures, stamps, lever arm."""

import math

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.frames import enu_between
from navlearn.logs.synthetic.aiding import antenna, fix_errors, fix_table, odometer_table
from navlearn.logs.synthetic.figures import GnssGrade, OdometerGrade
from navlearn.logs.synthetic.inverse import Truth, integrate, truth_at
from navlearn.logs.synthetic.motion import Motion
from navlearn.logs.synthetic.profile import draw_motion

ORIGIN = (math.radians(44.0), math.radians(-76.0), 80.0)


@pytest.fixture(scope="module")
def motion() -> Motion:
    return draw_motion("town", duration=200.0, seed=8, standstill=5.0)


@pytest.fixture(scope="module")
def grid(motion: Motion) -> Truth:
    return integrate(motion, ORIGIN, np.arange(40001) / 200.0)


def enu(table: pd.DataFrame, lat: np.ndarray, lon: np.ndarray, height: np.ndarray) -> np.ndarray:
    columns = [torch.tensor(table[c].to_numpy()) for c in ("lat", "lon", "height")]
    return np.stack(
        [x.numpy() for x in enu_between(*columns, *(torch.tensor(a) for a in (lat, lon, height)))],
        axis=-1,
    )


def test_odometer_scale_noise_and_step() -> None:
    t = np.arange(20_000) / 10.0
    speed = np.full_like(t, 15.0)
    grade = OdometerGrade(scale_factor_percent=1.0, noise=0.1)
    means = [odometer_table(t, speed, grade=grade, seed=s)["speed"].mean() for s in range(200)]
    assert np.std(means) / 15.0 == pytest.approx(0.01, rel=0.15)
    read = odometer_table(t, speed, grade=grade, seed=1)["speed"]
    assert np.std(read) == pytest.approx(0.1, rel=0.03)
    obd = odometer_table(t, speed, grade=OdometerGrade(step_kmh=1.0), seed=1)["speed"] * 3.6
    assert obd.to_numpy() == pytest.approx(54.0)


def test_odometer_at_standstill_and_creeping() -> None:
    speed = np.array([0.0, 0.1, 0.5, 2.0])
    grade = OdometerGrade(dead_speed_kmh=1.0, noise=0.05, step_kmh=0.1)
    read = odometer_table(np.arange(4.0), speed, grade=grade, seed=3)["speed"].to_numpy()
    assert read[:2].tolist() == [0.0, 0.0]
    assert read[2] > 0.3
    assert (read >= 0.0).all()


def test_fix_errors_have_their_figures() -> None:
    t = np.arange(100_000.0)
    grade = GnssGrade(
        noise=1.0,
        correlated_noise=2.0,
        correlation_time=20.0,
        vertical_factor=1.5,
        velocity_noise=0.1,
    )
    position, velocity = fix_errors(t, grade=grade, seed=1)
    std = position.std(axis=0)
    assert std == pytest.approx(np.array((1.0, 1.0, 1.5)) * math.sqrt(5.0), rel=0.08)
    for lag in (5, 20):
        centred = position[:, 0]
        correlation = np.mean(centred[:-lag] * centred[lag:])
        assert correlation == pytest.approx(4.0 * math.exp(-lag / 20.0), rel=0.15)
    assert velocity.std(axis=0) == pytest.approx([0.1, 0.1, 0.15], rel=0.03)


def test_spikes_come_at_their_rate_and_change_nothing_else() -> None:
    t = np.arange(50_000.0)
    grade = GnssGrade(noise=0.5)
    calm, _ = fix_errors(t, grade=grade, seed=4)
    hit, _ = fix_errors(t, grade=GnssGrade(noise=0.5, spike_probability=0.01, spike=40.0), seed=4)
    spikes = np.abs(hit - calm).max(axis=1) > 1e-9
    assert spikes.mean() == pytest.approx(0.01, rel=0.15)
    assert np.std((hit - calm)[spikes, 0]) == pytest.approx(40.0, rel=0.15)


def test_fix_table_holds_the_errors_and_what_the_receiver_believes(
    motion: Motion, grid: Truth
) -> None:
    t = np.arange(0.0, 200.0)
    truth = truth_at(grid, motion, t)
    grade = GnssGrade(noise=3.0, correlated_noise=4.0, velocity_noise=0.2)
    table = fix_table(t, truth, grade=grade, lever_arm=(0.0, 0.0, 0.0), seed=2)
    position, velocity = fix_errors(t, grade=grade, seed=2)
    found = enu(table, truth.lat, truth.lon, truth.height)
    np.testing.assert_allclose(found, position, atol=2e-4)
    measured = table[["v_e", "v_n", "v_u"]].to_numpy()
    np.testing.assert_allclose(measured - truth.v_l, velocity, atol=1e-12)
    assert table["std_e"].to_numpy() == pytest.approx(5.0)
    assert table["std_u"].to_numpy() == pytest.approx(8.0)
    assert table["std_v"].to_numpy() == pytest.approx(0.2)
    assert table["satellites"].between(4, 20).all()


def test_antenna_is_where_the_lever_arm_puts_it_and_moves_with_the_car(
    motion: Motion, grid: Truth
) -> None:
    arm = (0.4, -1.2, 1.5)
    t = np.linspace(20.0, 190.0, 400)
    truth = truth_at(grid, motion, t)
    lat, lon, height, v = antenna(truth, arm)
    table = pd.DataFrame({"lat": lat, "lon": lon, "height": height})
    offset = enu(table, truth.lat, truth.lon, truth.height)
    assert np.linalg.norm(offset, axis=1) == pytest.approx(np.linalg.norm(arm), rel=1e-5)
    k = truth.kinematics
    behind = offset[:, 0] * np.sin(k.azimuth) + offset[:, 1] * np.cos(k.azimuth)
    assert behind == pytest.approx(-1.2, abs=0.15)
    assert offset[:, 2] == pytest.approx(1.5, abs=0.15)
    # Its velocity is the rate of change of its own position.
    h = 0.01
    before, after = (antenna(truth_at(grid, motion, t + s), arm) for s in (-h, h))
    moved = enu(
        pd.DataFrame(dict(zip(("lat", "lon", "height"), after[:3], strict=True))), *before[:3]
    )
    np.testing.assert_allclose(moved / (2.0 * h), v, atol=2e-3)
