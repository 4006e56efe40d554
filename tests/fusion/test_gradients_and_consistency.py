"""Gradients through the filter, and whether it is as good as it says."""

import sys

import pytest
import torch

from navlearn.filters.consistency import mean_band, nees
from navlearn.fusion.error_state import initial_belief, position_difference
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind
from navlearn.fusion.options import EkfOptions
from navlearn.states import NavState


def end_of(options, d, method):
    ekf = LooselyCoupledEkf(options)
    belief = initial_belief(options, d.start)

    def end(yaw_rate, speed, azimuth, log_noise):
        samples = d.samples._replace(yaw_rate=yaw_rate, speed=speed)
        begin = belief._replace(state=belief.state._replace(azimuth=azimuth))
        history = torch.func.functional_call(
            ekf, {"log_noise": log_noise}, (begin, samples, d.fixes, d.timing), {"method": method}
        )
        out = NavState(*(x[:, -1] for x in history.trajectory[:4]))
        east_north = position_difference(out, d.start)[..., :2]
        last = history.belief.covariance[:, -1].diagonal(dim1=-2, dim2=-1)
        return east_north, out.azimuth, last.log()

    inputs = (d.samples.yaw_rate, d.samples.speed, d.start.azimuth, ekf.log_noise.detach())
    return end, tuple(x.clone().requires_grad_() for x in inputs)


@pytest.mark.parametrize("model", ["bias_scale", "shen2010_full"])
@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_gradcheck_through_the_filter(make_drive, method, model):
    d = make_drive(seconds=3, rate=2)
    options = EkfOptions(model=model, gate=GateOptions(probability=1.0))
    end, inputs = end_of(options, d, method)
    assert torch.autograd.gradcheck(end, inputs, eps=1e-4, atol=2e-4, rtol=1e-3, fast_mode=True)


def test_gradient_of_the_fast_form_is_that_of_the_loop(make_drive):
    d = make_drive(seconds=40, rate=10)
    found = []
    for method in ("exact", "fast"):
        end, inputs = end_of(EkfOptions(), d, method)
        position, azimuth, spread = end(*inputs)
        loss = position.square().sum() + 100.0 * azimuth.sum() + spread.sum()
        found.append(torch.autograd.grad(loss, inputs))
    # the drive forgets the azimuth it started with: of the loss's 100 hardly anything is left
    for exact, fast, least in zip(*found, (0.0, 0.0, 100.0, 0.0), strict=True):
        scale = exact.norm().clamp(min=least)
        assert float((fast - exact).norm() / scale) < (1e-3 if least else 1e-4)


def test_noise_can_be_learned_through_the_filter(make_drive):
    d = make_drive(seconds=30, rate=10)
    ekf = LooselyCoupledEkf(EkfOptions())
    ekf.log_noise.requires_grad_(True)
    history = ekf(initial_belief(ekf.options, d.start), d.samples, d.fixes, d.timing)
    (gradient,) = torch.autograd.grad(history.nis.nansum(), ekf.log_noise)
    assert bool(torch.isfinite(gradient).all())
    # larger measurement noise explains innovations away
    assert float(gradient[ekf.noise._fields.index("position_floor")]) < 0.0


def monte_carlo(model_drives, runs):
    """Run a filter on drives whose errors are drawn from its own model."""
    options, belief, d, sensors = model_drives(runs, 60, 11)
    with torch.no_grad():
        history = LooselyCoupledEkf(options)(belief, d.samples, d.fixes, d.timing)
    truth = NavState(*(torch.gather(x.expand(runs, -1), 1, history.end) for x in d.truth[:4]))
    at = history.belief
    error = torch.cat(
        (
            position_difference(at.state, truth),
            (at.state.azimuth - truth.azimuth).unsqueeze(-1),
            at.sensor - sensors,
        ),
        -1,
    )
    return history, nees(error, at.covariance)


def shares_in_bands(model_drives, runs):
    """Return per quantity: its mean, its 95 % band per epoch, and the share of epochs inside."""
    history, squares = monte_carlo(model_drives, runs)
    table = {}
    for name, values, degrees in (
        ("NEES", squares, 7),
        ("NIS of position", history.nis[..., Kind.POSITION], 3),
        ("NIS of velocity", history.nis[..., Kind.VELOCITY], 3),
    ):
        band = mean_band(degrees, runs)
        epochs = values.mean(0)
        inside = (epochs > band.low) & (epochs < band.high)
        table[name] = (float(epochs.mean()), band, float(inside.double().mean()))
        if name != "NEES":
            # innovations of an honest filter are white: all of them are independent squares
            whole = mean_band(degrees, values.numel(), 0.999)
            assert whole.low < table[name][0] < whole.high, name
    for name, (mean, band, share) in table.items():
        limits = f"95 % band {band.low:.3f} to {band.high:.3f}"
        sys.stdout.write(f"{name:16} {mean:6.3f}, {limits}, {share:.0%} of epochs inside\n")
    return table


def test_the_filter_is_as_good_as_it_says(model_drives):
    for name, (_, _, share) in shares_in_bands(model_drives, 20).items():
        assert share > 0.8, name


@pytest.mark.slow
def test_the_filter_is_as_good_as_it_says_over_a_hundred_runs(model_drives):
    for name, (mean, band, share) in shares_in_bands(model_drives, 100).items():
        assert band.low < mean < band.high, name
        # errors stay for long: that NEES of one epoch is outside, its neighbours' are
        assert share > (0.85 if name == "NEES" else 0.9), name
