"""An odometer that cuts its speed to whole steps reads half a step low: the filter finds it."""

from dataclasses import replace

import numpy as np
import pytest

from navlearn.fusion.options import EkfOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic.simulate import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.navigator import Navigator, NavigatorOptions

STEP = 1.0 / 3.6
OPTIONS = EkfOptions(
    speed_terms=("scale", "offset"), mechanization=RissOptions(dimensions=2, hold_stationary=True)
)


@pytest.fixture(scope="module")
def drive() -> DriveLog:
    return simulate_drive(
        profile="mixed", grade="tactical", duration=900.0, seed=4, imu_rate_hz=10.0
    ).log


def offset_of(log: DriveLog) -> tuple[float, float]:
    """Return the estimated offset and its standard deviation, m/s."""
    line = riss_timeline(log, rate_hz=10.0)
    navigator = Navigator(NavigatorOptions(filter=OPTIONS))
    belief = navigator.run(line.samples, line.fixes, line.timing).history.belief
    at = navigator.filter.model.layout.names.index("speed_offset")
    value = belief.sensor[-1, at - navigator.filter.model.layout.first_sensor]
    return float(value), float(belief.covariance[-1, at, at].sqrt())


def test_an_odometer_in_cut_steps_reads_half_a_step_low(drive: DriveLog):
    cut = drive.odometer.assign(speed=np.floor(drive.odometer["speed"] / STEP) * STEP)
    found, sigma = offset_of(replace(drive, odometer=cut))
    assert found == pytest.approx(0.5 * STEP, abs=0.03)
    assert sigma < 0.03


def test_an_odometer_without_steps_has_no_offset(drive: DriveLog):
    found, sigma = offset_of(drive)
    assert found == pytest.approx(0.0, abs=0.03)
    assert sigma < 0.03
