"""An error-free drive, resampled and dead-reckoned, stays on its truth whatever the rate."""

import numpy as np
import pytest
import torch

from navlearn.frames import enu_between
from navlearn.logs.reference import reference_at
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic.simulate import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import NavState


@pytest.fixture(scope="module")
def ideal():
    return simulate_drive(duration=300.0, seed=3, grade="ideal").ideal


# A quarter of a metre in 300 s is RISS itself: its yaw rate knows no pitch and roll rates.
@pytest.mark.parametrize(("rate_hz", "limit"), [(100.0, 0.35), (10.0, 0.35), (4.0, 0.5)])
def test_dead_reckoning_of_an_ideal_drive(ideal, rate_hz, limit):
    line = riss_timeline(ideal, rate_hz=rate_hz)
    middle = reference_at(ideal, line.t - 0.5 / rate_hz)
    pitch, roll = (torch.tensor(middle[name].to_numpy()) for name in ("pitch", "roll"))
    samples = line.samples._replace(pitch=pitch, roll=roll)
    first = reference_at(ideal, np.array([max(line.start_time, 0.0)]))
    columns = ("lat", "lon", "height", "azimuth")
    start = NavState(*(torch.tensor(first[name].iloc[0]) for name in columns))
    found = riss_over_time(start, samples, options=RissOptions(dimensions=3))
    truth = reference_at(ideal, line.t)
    place = (torch.tensor(truth[name].to_numpy()) for name in ("lat", "lon", "height"))
    east, north, _ = enu_between(found.lat, found.lon, found.height, *place)
    assert float(torch.hypot(east, north).max()) < limit


def test_stamping_means_as_instants_would_show(ideal):
    """The half sample that ``interval_means`` accounts for, at a coarse IMU rate."""
    coarse = simulate_drive(duration=300.0, seed=3, grade="ideal", imu_rate_hz=10.0).ideal
    fine = riss_timeline(ideal, rate_hz=10.0).samples.yaw_rate
    mine = riss_timeline(coarse, rate_hz=10.0).samples.yaw_rate
    np.testing.assert_allclose(mine, fine, atol=2e-4)
