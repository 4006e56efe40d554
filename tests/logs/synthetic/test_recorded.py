"""A simulated drive along a recorded trajectory."""

import math
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import LogError
from navlearn.logs.synthetic import motion_from_trajectory, simulate_drive

DATA = Path(
    os.environ.get("NAVLEARN_DATA") or Path(__file__).resolve().parents[3] / ".." / "shared/data"
)
BOREAS = DATA / "boreas_poses/csv/boreas-2021-08-05-13-34/reference.csv.gz"


def horizontal_error(reference: pd.DataFrame, record: pd.DataFrame) -> np.ndarray:
    lat, lon = (np.interp(reference["t"], record["t"], record[c]) for c in ("lat", "lon"))
    return np.hypot(
        (reference["lat"] - lat) * 6.37e6, (reference["lon"] - lon) * 6.37e6 * np.cos(lat)
    ).to_numpy()


@pytest.fixture(scope="module")
def record() -> pd.DataFrame:
    """A drive of ours, taken at 5 Hz with 3 cm of noise, as if somebody had recorded it."""
    drive = simulate_drive(
        profile="suburb", grade="ideal", duration=300.0, seed=6, reference_rate_hz=5.0
    )
    table = drive.log.reference
    assert table is not None
    noise = np.random.default_rng(0).standard_normal((2, len(table))) * 0.03 / 6.37e6
    return table.assign(lat=table["lat"] + noise[0], lon=table["lon"] + noise[1])


def test_a_recorded_drive_is_driven_again(record: pd.DataFrame) -> None:
    motion = motion_from_trajectory(record[["t", "lat", "lon", "height"]])
    again = simulate_drive(profile=motion, duration=1e6, grade="ideal", reference_rate_hz=5.0)
    truth = again.log.reference
    assert truth is not None
    assert motion.duration == pytest.approx(300.0)
    assert truth["t"].iloc[-1] == pytest.approx(300.0)
    assert horizontal_error(truth, record).max() < 8.0
    turning = np.abs(np.unwrap(truth["azimuth"]) - np.unwrap(record["azimuth"]))
    moving = np.hypot(record["v_e"], record["v_n"]).to_numpy() > 3.0
    assert np.rad2deg(np.median(turning[moving])) < 0.5
    assert np.abs(truth["height"] - record["height"]).max() < 1.5
    assert (motion.at(np.array([2.0, 10.0])).speed == 0.0).all()


@pytest.mark.skipif(not BOREAS.is_file(), reason="needs ../shared/data/boreas_poses")
def test_boreas_poses_are_followed() -> None:
    poses = pd.read_csv(BOREAS)
    table = pd.DataFrame(
        {
            "t": poses["t"] - poses["t"].iloc[0],
            "lat": np.deg2rad(poses["lat"]),
            "lon": np.deg2rad(poses["lon"]),
            "height": poses["alt"],
        }
    )
    motion = motion_from_trajectory(table)
    drive = simulate_drive(profile=motion, duration=1e6, imu_rate_hz=10.0, reference_rate_hz=2.0)
    truth = drive.log.reference
    assert truth is not None
    assert horizontal_error(truth, table).max() < 5.0
    k = motion.at(np.arange(0.0, motion.duration, 0.05))
    assert np.abs(k.acceleration).max() < 4.0
    assert np.abs(k.speed * k.azimuth_rate).max() < 4.0
    course = np.interp(truth["t"], table["t"], np.unwrap(np.deg2rad(poses["heading"])))
    fast = np.hypot(truth["v_e"], truth["v_n"]).to_numpy() > 5.0
    wrong = np.angle(np.exp(1j * (truth["azimuth"].to_numpy() - course)))[fast]
    # The poses' own heading is that of the lidar, mounted a degree askew.
    assert abs(np.rad2deg(np.median(wrong))) < 2.0
    assert np.rad2deg(np.median(np.abs(wrong - np.median(wrong)))) < 0.5


def test_refusals(record: pd.DataFrame) -> None:
    good = record[["t", "lat", "lon", "height"]]
    with pytest.raises(LogError, match="no column height"):
        motion_from_trajectory(good.drop(columns="height"))
    with pytest.raises(LogError, match="found 5 rows"):
        motion_from_trajectory(good.iloc[:5])
    with pytest.raises(LogError, match="all finite"):
        motion_from_trajectory(good.assign(lat=math.nan))
    with pytest.raises(LogError, match="does not increase at row 3"):
        motion_from_trajectory(good.assign(t=good["t"].where(good.index != 2, 0.0)))
    with pytest.raises(LogError, match="not in radians"):
        motion_from_trajectory(good.assign(lat=np.rad2deg(good["lat"])))
    with pytest.raises(LogError, match="never moves"):
        motion_from_trajectory(good.iloc[:100])
