"""Standstills of logs: where they are, what is refused, and real ones."""

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.logs.allan.standstill_noise import standstill_noise
from navlearn.logs.allan.stretch import still_stretches, stretch_of
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.reading import read_log

RATE = 20.0
ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("NAVLEARN_DATA", ROOT / ".." / "shared" / "data"))


def bench(seconds: float = 300.0, *, n: float = 1e-4, odometer: bool = True) -> DriveLog:
    """Return a log that stands for its first 2/3, then drives and shakes."""
    rng = np.random.default_rng(1)
    t = np.arange(int(seconds * RATE)) / RATE
    moves = t > seconds * 2.0 / 3.0
    noise = {"gyro": n * math.sqrt(RATE), "accel": 1e-3 * math.sqrt(RATE)}
    imu = pd.DataFrame({"t": t})
    for kind, sigma in noise.items():
        for axis in "xyz":
            shaken = np.where(moves, 0.3, 0.0) * rng.normal(size=t.size)
            imu[f"{kind}_{axis}"] = sigma * rng.normal(size=t.size) + shaken
    imu["accel_z"] += 9.81
    clock = np.arange(0.0, seconds, 1.0)
    speed = np.where(clock > seconds * 2.0 / 3.0, 10.0, 0.0)
    return DriveLog(
        imu=imu,
        odometer=pd.DataFrame({"t": clock, "speed": speed} if odometer else {"t": [], "speed": []}),
        fixes=pd.DataFrame({"t": [], "lat": [], "lon": []}),
        reference=None,
        metadata=LogMetadata(name="bench"),
    )


def without(log: DriveLog, start: float, stop: float) -> DriveLog:
    inside = (log.imu["t"] > start) & (log.imu["t"] < stop)
    return replace(log, imu=log.imu[~inside].reset_index(drop=True))


@pytest.mark.parametrize("odometer", [True, False])
def test_the_longest_standstill_is_found_by_odometer_or_by_six_axes(odometer: bool) -> None:
    found = still_stretches(bench(odometer=odometer))
    assert 0.0 <= found[0].start < 6.0
    assert 190.0 < found[0].stop <= 200.0
    assert len(found) == 1


def test_the_noise_of_every_axis_is_told() -> None:
    found = standstill_noise(bench(1800.0))
    assert [one.axis for one in found.axes] == [
        *("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
    ]
    assert found.rate_hz == pytest.approx(RATE)
    assert found.left_out == {}
    for one in found.axes:
        true = 1e-4 if one.is_gyro else 1e-3
        assert one.terms.white.value == pytest.approx(true, rel=0.05), one.axis
        assert one.notes == ()


def test_a_stretch_may_be_said() -> None:
    found = stretch_of(bench(), 10.0, 60.0)
    assert (found.start, found.stop, found.length) == (10.0, 60.0, 50.0)
    assert stretch_of(bench(), 250.0).stop == pytest.approx(300.0 - 1.0 / RATE)


@pytest.mark.parametrize("odometer", [True, False])
def test_a_stretch_in_which_the_car_moves_is_said(odometer: bool) -> None:
    log = bench(odometer=odometer)
    still = standstill_noise(log, start=20.0, stop=180.0)
    assert all(one.notes == () for one in still.axes)
    driven = standstill_noise(log, start=100.0, stop=250.0)
    for one in driven.axes:
        (said, seconds) = next((x, int(x.split()[4])) for x in one.notes if "car moves" in x)
        assert seconds == pytest.approx(50.0, abs=3.0), said


def test_gaps_split_standstills_and_are_refused_where_asked_for() -> None:
    gapped = without(bench(), 80.0, 81.0)
    found = still_stretches(gapped)
    assert found[0].length == pytest.approx(118.0, abs=4.0)
    assert all(one.stop <= 80.1 or one.start >= 80.9 for one in found)
    with pytest.raises(LogError, match=r"gyro_z misses samples in 1 places.*t = 80"):
        standstill_noise(gapped, start=10.0, stop=190.0, axes=("gyro_z",))


def test_many_single_lost_samples_are_refused() -> None:
    log = bench()
    kept = np.arange(len(log.imu)) % 20 != 7
    thin = replace(log, imu=log.imu[kept].reset_index(drop=True))
    with pytest.raises(LogError, match="one here, one there"):
        standstill_noise(thin, start=10.0, stop=100.0, axes=("gyro_z",))


def test_a_channel_that_never_changes_is_refused_or_left_out() -> None:
    log = bench()
    dead = replace(log, imu=log.imu.assign(gyro_x=0.0))
    with pytest.raises(LogError, match="gyro_x reads 0 throughout"):
        standstill_noise(dead, axes=("gyro_x",))
    found = standstill_noise(dead)
    assert found.axis("gyro_x") is None
    assert "throughout" in found.left_out["gyro_x"]


def test_a_coarse_step_is_said() -> None:
    log = bench()
    step = 10.0 * 1e-4 * math.sqrt(RATE)
    coarse = step * np.round(log.imu["gyro_z"] / step + 0.47)
    found = standstill_noise(replace(log, imu=log.imu.assign(gyro_z=coarse)), axes=("gyro_z",))
    assert any("coarser than its noise" in note for note in found.axes[0].notes)


def test_an_idling_engine_is_said() -> None:
    log = bench(900.0)
    hum = 3e-3 * np.sin(2.0 * np.pi * 7.0 * log.imu["t"])
    found = standstill_noise(
        replace(log, imu=log.imu.assign(gyro_z=log.imu["gyro_z"] + hum)), axes=("gyro_z",)
    )
    assert any("a vibration at 7" in note for note in found.axes[0].notes)


def test_too_short_a_standstill_is_refused_with_what_there_is() -> None:
    with pytest.raises(LogError, match=r"the longest lasts 1\d s of standstill"):
        standstill_noise(bench(30.0))
    with pytest.raises(LogError, match="15 s of the log lie between 5 and 20"):
        standstill_noise(bench(), start=5.0, stop=20.0)
    moving = bench()
    always = replace(moving, odometer=moving.odometer.assign(speed=9.0))
    with pytest.raises(LogError, match="there is none"):
        standstill_noise(always)


def test_nothing_can_tell_a_standstill_without_odometer_and_full_imu() -> None:
    log = bench(odometer=False)
    with pytest.raises(LogError, match="say where it stands"):
        standstill_noise(replace(log, imu=log.imu[["t", "gyro_z"]]))


def test_unknown_and_missing_axes_are_refused() -> None:
    with pytest.raises(ConfigError, match="gyro_z"):
        standstill_noise(bench(), axes=("gyro_zz",))
    log = bench()
    with pytest.raises(LogError, match="accel_z has 0 values"):
        standstill_noise(replace(log, imu=log.imu.drop(columns="accel_z")), axes=("accel_z",))


def test_kingston_stands_for_nine_minutes() -> None:
    if not (DATA / "kingston_2008").is_dir():
        pytest.skip("the Kingston log is not there")
    found = standstill_noise(read_log(ROOT / "datasets" / "kingston_2008.yaml"), axes=("gyro_z",))
    assert 500.0 < found.stretch.length < 560.0
    assert 0.03 < math.degrees(found.axes[0].terms.white.value) * 60.0 < 0.3
