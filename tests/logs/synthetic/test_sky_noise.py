"""The noise that a filter is told of a sky is that of its ranges."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn.gnss.range_noise import range_noise, range_variance, rate_variance
from navlearn.logs.synthetic import PRESETS, noise_of_sky, simulate_drive


@pytest.mark.parametrize("preset", ["open_sky", "suburban", "urban"])
def test_errors_of_direct_signals_have_unit_size(preset: str) -> None:
    # Quick processes, so that one drive holds many draws; a speed that changes no multipath.
    sky = replace(
        PRESETS[preset],
        ionosphere_time=3.0,
        troposphere_time=3.0,
        orbit_time=3.0,
        multipath_time=3.0,
        multipath_speed=1e6,
    )
    drive = simulate_drive(
        profile="suburb", duration=600.0, seed=12, imu_rate_hz=5.0, satellites=sky
    )
    assert drive.log.ranges is not None
    assert drive.range_truth is not None
    ranges, truth = drive.log.ranges, drive.range_truth.table
    elevation, cn0, none = (
        torch.tensor(x.to_numpy()) for x in (truth["elevation"], ranges["cn0"], 0.0 * ranges["cn0"])
    )
    direct = (truth["reflection"] == 0.0).to_numpy()
    noise = range_noise(noise_of_sky(sky))
    found = truth["range_error"] / np.sqrt(range_variance(noise, elevation, cn0, none).numpy())
    assert found[direct].std() == pytest.approx(1.0, rel=0.06)
    found = truth["rate_error"] / np.sqrt(rate_variance(noise, elevation, cn0, none).numpy())
    assert found[direct].std() == pytest.approx(1.0, rel=0.04)
