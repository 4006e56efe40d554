"""A start that knows hardly anything of azimuth: who finds it, extended or unscented filter."""

import math
import sys
import warnings
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.filters.consistency import mean_band, nees
from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.filters_of import ins_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import moved_belief, state_difference
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.states import InsState

ERRORS = (60.0, 120.0, -120.0, 150.0, 180.0)
UNKNOWN = math.pi / math.sqrt(3.0)
"""Deviation of an azimuth that may be anything, rad."""

NARROW = UnscentedOptions(alpha=0.35)
"""Points 1.4 deviations from the mean: farther out they would meet behind the car."""


def found(d: Any, unscented: UnscentedOptions | None, **more: Any) -> Tensor:
    """Azimuth errors after each block, deg, from starts that err by ERRORS, shape (B, K)."""
    options = InsEkfOptions(unscented=unscented, initial=InsInitialOptions(azimuth=UNKNOWN), **more)
    count = len(ERRORS)
    start, truth, samples, fixes, timing = map_tree(
        tuple(d), lambda x: x.expand(count, *x.shape).clone()
    )
    wrong = torch.zeros(count, initial_ins_belief(options, start).sensor.shape[-1] + 9).double()
    # an azimuth error is −φ_up
    wrong[:, 8] = -torch.tensor(ERRORS, dtype=torch.float64) * math.pi / 180.0
    belief = moved_belief(initial_ins_belief(options, start), wrong)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # innovations of a car turned round are large
        history = ins_filter(options)(belief, samples, fixes, timing)
    rows = torch.arange(count).unsqueeze(-1)
    at = InsState(*(channel[rows, history.end] for channel in truth))
    return state_difference(history.belief.state, at)[..., 8].abs() * 180.0 / math.pi


def test_behind_the_gate_points_find_an_azimuth_that_a_tangent_does_not(
    make_drive: Any, lever_arm: Any
) -> None:
    """The gate refuses what a filter that is sure of a wrong azimuth does not foresee.

    Turned right round neither finds back soon: backwards is an equilibrium for odometer and axle.
    """
    d = make_drive(seconds=24, rate=20, seed=2)
    points, tangent = (found(d, u, lever_arm=lever_arm)[:, -1] for u in (NARROW, None))
    sys.stdout.write(f"unscented {points.tolist()}, extended {tangent.tolist()}\n")
    assert float(points[:3].max()) < 2.0
    assert float(tangent[1:3].max()) > 10.0


TINY = 1e-8


def honest(unscented: UnscentedOptions, **more: Any) -> InsEkfOptions:
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
        unscented=unscented,
        **more,
    )


def table_of(
    make_clean: Any, model_drives: Any, lever_arm: Any, alpha: float, runs: int, seconds: int
) -> dict[str, tuple[float, Any, float]]:
    """Return per quantity its mean, its 95 % band per epoch, and the share of epochs inside."""
    options = honest(UnscentedOptions(alpha=alpha), lever_arm=lever_arm)
    belief, d, sensors = model_drives(options, runs, 17, make_clean(float(seconds), 25))
    with torch.no_grad():
        history = ins_filter(options)(belief, d.samples, d.fixes, d.timing)
    rows = torch.arange(runs).unsqueeze(-1)
    truth = InsState(*(channel[rows, history.end] for channel in d.truth))
    error = state_difference(history.belief.state, truth)
    error = torch.cat((error, history.belief.sensor - sensors.unsqueeze(1)), -1)
    n, covariance = error.shape[-1], history.belief.covariance
    found = {}
    for name, values, degrees in (
        ("NEES", nees(error, covariance), n),
        ("NEES of navigation", nees(error[..., :9], covariance[..., :9, :9]), 9),
        ("NIS of position", history.nis[..., InsKind.POSITION], 3),
        ("NIS of velocity", history.nis[..., InsKind.VELOCITY], 3),
        ("NIS of odometer", history.nis[..., InsKind.ODOMETER], 1),
    ):
        band, epochs = mean_band(degrees, runs), values.mean(0)
        inside = float(((epochs > band.low) & (epochs < band.high)).double().mean())
        found[name] = (float(epochs.mean()), band, inside)
        limits = f"95 % band {band.low:.3f} to {band.high:.3f}"
        sys.stdout.write(
            f"alpha {alpha}: {name:18} {found[name][0]:6.3f}, {limits}, {inside:.0%} inside\n"
        )
    return found


def test_the_filter_is_as_good_as_it_says(
    make_clean: Any, model_drives: Any, lever_arm: Any
) -> None:
    for name, (mean, band, share) in table_of(
        make_clean, model_drives, lever_arm, 0.5, 40, 20
    ).items():
        assert band.low < mean < band.high, name
        assert share > 0.75, name


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [1.0, 0.5, 1e-3])
def test_the_filter_is_as_good_as_it_says_over_many_runs(
    make_clean: Any, model_drives: Any, lever_arm: Any, alpha: float
) -> None:
    """Bands: pytest -m slow -s tests/fusion/ins/test_ins_unscented_start.py."""
    for name, (mean, band, share) in table_of(
        make_clean, model_drives, lever_arm, alpha, 100, 60
    ).items():
        assert band.low < mean < band.high, name
        assert share > 0.8, name
