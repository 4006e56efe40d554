"""Tilt on a real drive against the reference's pitch and roll."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch

from navlearn.mechanization import TiltOptions, tilt_from_specific_force

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
DRIVE = Path(os.environ.get("NAVLEARN_DATA", SHARED)) / "kingston_2008" / "csv"
RATE = 10.0
ODOMETER_DELAY = 0.25  # s, the middle of what the card of the log tells


def _table(name: str) -> dict[str, np.ndarray]:
    table = np.genfromtxt(DRIVE / f"{name}.csv.gz", delimiter=",", names=True)
    return {column: table[column] for column in table.dtype.names}


@pytest.fixture(scope="module")
def kingston():
    if not DRIVE.is_dir():
        pytest.skip("the Kingston drive is not beside the repository")
    return _table("imu"), _table("odometer"), _table("reference")


def _errors(kingston, options: TiltOptions) -> tuple[float, float]:
    """Return standard deviations of pitch and roll error while driving, degrees."""
    imu, odometer, reference = kingston
    t = np.arange(imu["t"][0], imu["t"][-1], 1.0 / RATE)
    f_y = np.interp(t, imu["t"], imu["accel_x"])
    f_x = -np.interp(t, imu["t"], imu["accel_y"])  # the file's y axis points left
    yaw_rate = np.interp(t, imu["t"], imu["gyro_z"])
    speed = np.interp(t - ODOMETER_DELAY, odometer["t"], odometer["speed"])
    channels = [torch.from_numpy(x) for x in (f_y, f_x, speed, yaw_rate)]
    dt, gravity = torch.full_like(channels[0], 1.0 / RATE), torch.tensor(9.806).double()
    found = tilt_from_specific_force(*channels, dt, gravity, options)
    assert found.clamped.sum() == 0
    moving = np.interp(reference["t"], t, speed) > 5.0
    return tuple(
        float(np.std((np.degrees(np.interp(reference["t"], t, ours)) - theirs)[moving]))
        for ours, theirs in ((found.pitch, reference["pitch"]), (found.roll, reference["roll"]))
    )


def test_defaults_agree_with_the_reference(kingston):
    pitch, roll = _errors(kingston, TiltOptions())
    assert pitch == pytest.approx(0.41, abs=0.01)
    assert roll == pytest.approx(0.50, abs=0.01)


def test_static_tilt_is_several_times_worse(kingston):
    pitch, roll = _errors(kingston, TiltOptions(method="static"))
    assert pitch == pytest.approx(2.32, abs=0.02)
    assert roll == pytest.approx(1.71, abs=0.02)


def test_the_default_time_constant_lies_in_a_flat_optimum(kingston):
    best = sum(_errors(kingston, TiltOptions()))
    for time_constant in (0.75, 3.0):
        assert best < sum(_errors(kingston, TiltOptions(time_constant=time_constant))) + 0.02
