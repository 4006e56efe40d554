"""Is the full-IMU filter as good as it says? Drives whose errors are drawn from its own model."""

import sys

import pytest
import torch

from navlearn.filters.consistency import mean_band, nees
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.filters_of import ins_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.states import InsState

TINY = 1e-8


def honest_options(**more):
    """Noise that is simulated exactly: white on all axes, constant sensor errors."""
    noise = InsNoiseOptions(
        gyro_random_walk=3e-4,
        accel_random_walk=3e-3,
        turn_noise=0.0,
        gyro_bias_walk=TINY,
        accel_bias_walk=TINY,
        gyro_scale_walk=TINY,
        accel_scale_walk=TINY,
        odometer_scale_walk=TINY,
        position_floor=0.0,
        height_floor=0.0,
        position_inflation=1.0,
        velocity_floor=0.0,
    )
    initial = InsInitialOptions(
        position=2.0,
        height=2.0,
        velocity=0.2,
        tilt=0.01,
        azimuth=0.03,
        gyro_bias=0.001,
        accel_bias=0.03,
        odometer_scale=0.01,
    )
    return InsEkfOptions(
        noise=noise,
        initial=initial,
        gate=GateOptions(probability=1.0),
        nonholonomic=False,
        zero_velocity=False,
        zero_angular_rate=False,
        **more,
    )


def shares_in_bands(make_clean, model_drives, options, runs, seconds, rate):
    """Return per quantity: its mean, its 95 % band per epoch, and the share of epochs inside."""
    belief, d, sensors = model_drives(options, runs, 17, make_clean(seconds, rate))
    with torch.no_grad():
        history = ins_filter(options)(belief, d.samples, d.fixes, d.timing)
    rows = torch.arange(runs).unsqueeze(-1)
    truth = InsState(*(channel[rows, history.end] for channel in d.truth))
    error = torch.cat(
        (
            state_difference(history.belief.state, truth),
            history.belief.sensor - sensors.unsqueeze(1),
        ),
        -1,
    )
    n = error.shape[-1]
    table = {}
    for name, values, degrees in (
        ("NEES", nees(error, history.belief.covariance), n),
        ("NEES of navigation", nees(error[..., :9], history.belief.covariance[..., :9, :9]), 9),
        ("NIS of position", history.nis[..., InsKind.POSITION], 3),
        ("NIS of velocity", history.nis[..., InsKind.VELOCITY], 3),
        ("NIS of odometer", history.nis[..., InsKind.ODOMETER], 1),
    ):
        band = mean_band(degrees, runs)
        epochs = values.mean(0)
        inside = (epochs > band.low) & (epochs < band.high)
        table[name] = (float(epochs.mean()), band, float(inside.double().mean()))
        if name.startswith("NIS"):
            # innovations of an honest filter are white: all of them are independent squares
            whole = mean_band(degrees, values.numel(), 0.999)
            assert whole.low < table[name][0] < whole.high, name
    for name, (mean, band, share) in table.items():
        limits = f"95 % band {band.low:.3f} to {band.high:.3f}"
        sys.stdout.write(f"{name:18} {mean:6.3f}, {limits}, {share:.0%} of epochs inside\n")
    return table


@pytest.mark.parametrize(
    ("unscented", "runs", "seconds"), [(None, 80, 40), (UnscentedOptions(alpha=0.5), 40, 20)]
)
def test_the_filter_is_as_good_as_it_says(
    make_clean, model_drives, lever_arm, unscented, runs, seconds
):
    options = honest_options(unscented=unscented, lever_arm=lever_arm)
    table = shares_in_bands(make_clean, model_drives, options, runs, seconds, 25)
    for name, (mean, band, share) in table.items():
        assert band.low < mean < band.high, name
        assert share > (0.8 if unscented is None else 0.75), name


def check_over_many_runs(make_clean, model_drives, options, seconds, rate):
    table = shares_in_bands(make_clean, model_drives, options, 100, seconds, rate)
    for name, (mean, band, share) in table.items():
        assert band.low < mean < band.high, name
        # errors stay for long: that NEES of one epoch is outside, its neighbours' are
        assert share > (0.85 if name.startswith("NEES") else 0.9), name


@pytest.mark.slow
@pytest.mark.parametrize("states", [15, 21])
def test_the_filter_is_as_good_as_it_says_over_many_runs(
    make_clean, model_drives, lever_arm, states
):
    options = honest_options(states=states, lever_arm=lever_arm)
    check_over_many_runs(make_clean, model_drives, options, 120, 50)


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [1.0, 0.5, None, 1e-3])
def test_the_unscented_filter_is_as_good_as_it_says_over_many_runs(
    make_clean, model_drives, lever_arm, alpha
):
    options = honest_options(unscented=UnscentedOptions(alpha=alpha), lever_arm=lever_arm)
    check_over_many_runs(make_clean, model_drives, options, 60, 25)
