"""A drive made for the checks: plain kinematics on a fine grid, faults of known size."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.drive_log import DriveLog, LogMetadata

LAT_0, LON_0 = math.radians(50.0), math.radians(8.0)
EARTH_RATE_UP = 7.292115e-5 * math.sin(LAT_0)
RADIUS_N, RADIUS_M = 6390702.0, 6372956.0  # prime vertical, meridian at 50° (WGS 84)


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What is wrong with the drive; a late stream has a positive latency (s)."""

    duration: float = 600.0
    seed: int = 1
    gyro_bias: float = 0.0
    gyro_scale: float = 1.0
    odometer_scale: float = 1.0
    gnss_latency: float = 0.0
    odometer_latency: float = 0.0
    odometer_latency_drift: float = 0.0
    odometer_step: float = 0.0
    position_noise: float = 1.0
    gyro_step: float = 0.0
    speed: Callable[[np.ndarray], np.ndarray] | None = None
    turn: Callable[[np.ndarray], np.ndarray] | None = None
    metadata: LogMetadata = field(default_factory=lambda: LogMetadata(name="made"))


def town_speed(t: np.ndarray) -> np.ndarray:
    """Two minutes of traffic again and again: a stop of 25 s, then driving with ups and downs."""
    phase = np.mod(t, 120.0)
    rise = np.clip((phase - 25.0) / 8.0, 0.0, 1.0) * np.clip((118.0 - phase) / 9.0, 0.0, 1.0)
    return rise * (12.0 + 3.0 * np.sin(2.0 * np.pi * phase / 31.0) + np.sin(0.7 * phase))


def town_turn(t: np.ndarray) -> np.ndarray:
    """Bends of either hand, none at a standstill."""
    wave = 0.12 * np.sin(2.0 * np.pi * t / 23.0) + 0.15 * np.sin(2.0 * np.pi * t / 61.0) ** 5
    return wave * np.clip(town_speed(t) / 6.0, 0.0, 1.0)


def make_drive(**wanted: object) -> DriveLog:
    """Return a drive with the faults that are named."""
    faults = Faults(**wanted)  # type: ignore[arg-type]
    draw = np.random.default_rng(faults.seed)
    grid = np.arange(-5.0, faults.duration + 5.0, 0.01)
    speed = (faults.speed or town_speed)(grid)
    turn = (faults.turn or town_turn)(grid)
    azimuth = 0.4 - np.concatenate(([0.0], np.cumsum(0.005 * (turn[1:] + turn[:-1]))))
    east, north = (
        np.concatenate(([0.0], np.cumsum(0.005 * (v[1:] + v[:-1]))))
        for v in (speed * np.sin(azimuth), speed * np.cos(azimuth))
    )

    def at(when: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.interp(when, grid, x)

    t = np.arange(0.0, faults.duration, 0.04)
    rate = faults.gyro_scale * (at(t, turn) + EARTH_RATE_UP) + faults.gyro_bias
    imu = pd.DataFrame(
        {
            "t": t,
            "gyro_x": 0.002 * draw.standard_normal(len(t)),
            "gyro_y": 0.002 * draw.standard_normal(len(t)),
            "gyro_z": _stepped(rate + 0.001 * draw.standard_normal(len(t)), faults.gyro_step),
            "accel_x": -at(t, speed * turn) + 0.05 * draw.standard_normal(len(t)),
            "accel_y": at(t, np.gradient(speed, grid)) + 0.05 * draw.standard_normal(len(t)),
            "accel_z": 9.81 + 0.05 * draw.standard_normal(len(t)),
        }
    )
    t_o = np.arange(0.0, faults.duration, 0.5)
    late = faults.odometer_latency + faults.odometer_latency_drift * (t_o - 0.5 * t_o[-1])
    noise = 0.02 * draw.standard_normal(len(t_o)) * (at(t_o - late, speed) > 0.0)
    told = faults.odometer_scale * at(t_o - late, speed) + noise
    odometer = pd.DataFrame({"t": t_o, "speed": _stepped(told, faults.odometer_step)})
    t_f = np.arange(1.0, faults.duration, 1.0)
    fixes = _track(t_f, t_f - faults.gnss_latency, at, east, north, speed, azimuth)
    for name, size in (("lat", 1.0 / RADIUS_M), ("lon", 1.5 / RADIUS_M), ("height", 2.0)):
        fixes[name] += faults.position_noise * size * draw.standard_normal(len(t_f))
    for name in ("v_e", "v_n", "v_u"):
        fixes[name] += 0.03 * draw.standard_normal(len(t_f))
    t_r = np.arange(0.0, faults.duration, 0.5)
    reference = _track(t_r, t_r, at, east, north, speed, azimuth)
    reference["azimuth"] = np.mod(at(t_r, azimuth), 2.0 * np.pi)
    return DriveLog(
        imu=imu, odometer=odometer, fixes=fixes, reference=reference, metadata=faults.metadata
    )


def _stepped(x: np.ndarray, step: float) -> np.ndarray:
    return x if step == 0.0 else step * np.round(x / step)


def _track(
    t: np.ndarray,
    when: np.ndarray,
    at: Callable[[np.ndarray, np.ndarray], np.ndarray],
    east: np.ndarray,
    north: np.ndarray,
    speed: np.ndarray,
    azimuth: np.ndarray,
) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "t": t,
            "lat": LAT_0 + at(when, north) / RADIUS_M,
            "lon": LON_0 + at(when, east) / (RADIUS_N * math.cos(LAT_0)),
            "height": 100.0,
            "v_e": at(when, speed * np.sin(azimuth)),
            "v_n": at(when, speed * np.cos(azimuth)),
            "v_u": 0.0,
        }
    )


@pytest.fixture(scope="session")
def healthy() -> DriveLog:
    """A drive with nothing wrong."""
    return make_drive()


@pytest.fixture
def changed(healthy: DriveLog) -> Callable[..., DriveLog]:
    """Return the healthy drive with columns of one table changed by functions."""

    def change(table: str, **columns: Callable[[pd.DataFrame], object]) -> DriveLog:
        before = healthy.tables()[table]
        now = {name: function(before) for name, function in columns.items()}
        return healthy.with_tables({table: before.assign(**now)})

    return change


@pytest.fixture
def drive() -> Callable[..., DriveLog]:
    """Return the maker of drives."""
    return make_drive


@pytest.fixture
def without(healthy: DriveLog) -> Callable[..., DriveLog]:
    """Return the healthy drive without columns of a table, or without the whole reference."""

    def drop(table: str, *names: str) -> DriveLog:
        if not names:
            return replace(healthy, **{table: None})
        return healthy.with_tables({table: healthy.tables()[table].drop(columns=list(names))})

    return drop
