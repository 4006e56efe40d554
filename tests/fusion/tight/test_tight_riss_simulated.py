"""One gyro and an odometer under simulated satellites: errors as large as told, upwards too."""

from typing import Any

import numpy as np
import pytest
import torch

from navlearn.frames import enu_between
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.options import ClockOptions, TightEkfOptions
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions
from navlearn.mechanization.options import RissOptions
from navlearn.tight_navigator import TightNavigator, TightNavigatorOptions

# errors that are white, and a filter that is told so
SKY = SatelliteOptions(
    systems=("G", "E"), ionosphere=0.0, troposphere=0.0, orbit=0.0, multipath=0.0
)
NOTHING = dict.fromkeys(
    ("orbit_clock", "ionosphere", "troposphere", "multipath", "rate_floor", "rate_multipath"), 0.0
)
TOLD = TightEkfOptions(
    range_noise=RangeNoiseOptions(thermal=SKY.thermal, rate_thermal=SKY.rate_thermal, **NOTHING),
    clock=ClockOptions(frequency_noise=SKY.clock_white, frequency_walk=SKY.clock_walk),
)


def ratios(dims: Any, seed: int) -> tuple[float, float]:
    """Mean squared error over variance: upwards, and per horizontal axis."""
    log = simulate_drive(
        profile="mixed",
        grade="mems_m",
        duration=300.0,
        seed=seed,
        imu_rate_hz=10.0,
        satellites=SKY,
    ).log
    line = riss_timeline(log, rate_hz=10.0, dims=dims)
    series = ranges_of(log, np.concatenate(([line.start_time], line.t.numpy())))
    vehicle = EkfOptions(mechanization=RissOptions(dimensions=dims))
    run = TightNavigator(TightNavigatorOptions(vehicle=vehicle, tight=TOLD)).run(
        line.samples, line.fixes, line.timing, series.ranges, series.timing
    )
    t, true = line.t[run.first :][run.history.end], log.reference
    assert true is not None
    there = [torch.from_numpy(np.interp(t, true["t"], true[k])) for k in ("lat", "lon", "height")]
    belief = run.history.belief
    error = torch.stack(enu_between(*belief.vehicle.state[:3], *there), -1)[40:]
    P = belief.covariance[40:]
    level = torch.linalg.solve(P[:, :2, :2], error[:, :2].unsqueeze(-1)).squeeze(-1)
    return (
        float((error[:, 2].square() / P[:, 2, 2]).mean()),
        float((error[:, :2] * level).sum(-1).mean()) / 2.0,
    )


@pytest.mark.parametrize("dims", [2, 3])
def test_a_car_knows_how_far_off_it_is_in_the_plane_and_upwards(dims: int) -> None:
    found = np.array([ratios(dims, seed) for seed in (11, 12, 13)])
    up, level = found.mean(axis=0)
    assert 0.6 < up < 1.5, found
    # beyond gyro and odometer the filter lets the car drift sideways, which simulated cars do not
    assert 0.4 < level < 1.1, found
