"""Networks of the position error: what they recover, and what a mean residual hides."""

import pytest
import torch

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.errors import ConfigError
from navlearn.learning.options import TrainingOptions
from navlearn.learning.position_fit import PositionFitOptions, fit_position, run_on_own_output
from navlearn.learning.position_series import PositionSeries, position_series

NAMES = ("ins_position", "gnss_position", "delay_steps")


def network(**changes):
    values = {"inputs": 3, "lags": 2, "hidden": 3, "linear_path": False, "safeguard": False}
    return AnarxOptions(**{**values, **changes})


def known_system(length=900, seed=0):
    """Return a record whose position error is the output of an ANARX network per axis."""
    generator = torch.Generator().manual_seed(seed)
    t = torch.arange(length, dtype=torch.float64) / 50.0
    ins = torch.stack([torch.sin(0.9 * t + k) + 0.3 * torch.cos(2.3 * t) for k in range(3)], -1)
    index = torch.arange(0, length, 10)
    series = position_series(t, ins, index, ins[index] + 0.2 * torch.cos(t[index]).unsqueeze(1))
    target = []
    for axis in range(3):
        model = Anarx(network())
        with torch.no_grad():
            for part in model.weights():
                part.copy_(0.7 * torch.randn(part.shape, generator=generator, dtype=torch.float64))
            model.linear.zero_()
            u = torch.stack((ins[:, axis], series.held[:, axis], series.delay / 5.0), -1)[:-1]
            y = model(u, torch.zeros(1, dtype=torch.float64))
        target.append(torch.cat((torch.zeros(1, 1, dtype=torch.float64), y)))
    # The truth of the system takes the place of what fixes tell.
    return series._replace(target=torch.cat(target, -1), known=torch.ones(length, dtype=bool))


@pytest.mark.parametrize("split", ["random", "time"])
def test_open_loop_recovers_a_known_system(split):
    series = known_system()
    training = TrainingOptions(loop="open", max_iterations=300, patience=300, ridge=0.0, starts=3)
    options = PositionFitOptions(network=network(), training=training, split=split, gap=5)
    fits = fit_position(series, options)
    for axis, fit in enumerate(fits):
        truth = series.target[1:, axis]
        residual = (fit.predicted[0] - truth)[fit.windows.part[0] == 2]
        assert float(residual.square().mean().sqrt()) < 2e-3 * float(truth.std())
    free = run_on_own_output(fits, series, NAMES)
    error = (free - series.target[1:]).square().mean(0).sqrt()
    assert bool((error < 0.02 * series.target.std(0)).all())


def test_run_from_a_row_on_reads_no_later_target():
    series = known_system(300)
    training = TrainingOptions(loop="open", max_iterations=5, starts=1)
    options = PositionFitOptions(network=network(), training=training)
    fits = fit_position(series, options)
    after = 120
    plain = run_on_own_output(fits, series, NAMES, after=after)
    poisoned = series._replace(target=series.target.clone())
    poisoned.target[after + 1 :] = torch.nan
    assert torch.equal(run_on_own_output(fits, poisoned, NAMES, after=after), plain)
    # Row by row it is the network's own step.
    model = fits[1].fitted.model
    u = torch.stack([series.ins[:, 1], series.held[:, 1], series.delay], -1)
    y = series.target[:, 1:2]
    state = model.warm_state(u[after - 1 : after], y[after : after + 1], y[after - 1])
    for k in range(after, after + 4):
        out, state = model.step(u[k], state)
        assert torch.allclose(out, plain[k - after, 1], atol=1e-9)


def noise_record(length=4000):
    generator = torch.Generator().manual_seed(1)
    t = torch.arange(length, dtype=torch.float64) / 5.0
    ins = torch.stack([100.0 * torch.sin(0.01 * t + k) for k in range(3)], -1)
    noise = 2.0 * torch.randn(length, 3, generator=generator, dtype=torch.float64)
    return position_series(t, ins, torch.arange(length), ins + noise)


def test_a_mean_residual_says_nothing():
    # White noise of 2 m: nothing can be predicted, yet any model with a constant has a mean
    # training residual of next to zero, as its normal equations demand.
    series = noise_record()
    training = TrainingOptions(
        loop="open", max_iterations=200, patience=200, ridge=0.0, starts=1, seed=2
    )
    small = network(inputs=1, lags=1, hidden=1)
    options = PositionFitOptions(network=small, training=training, inputs=("delay_steps",))
    for fit in fit_position(series, options):
        residual = fit.predicted - fit.windows.windows.y.squeeze(-1)
        train = residual[fit.windows.part == 0]
        test = residual[fit.windows.part == 2]
        # A quarter of the standard error that a mean of so many unrelated rows has.
        assert abs(float(train.mean())) < 0.25 * float(train.std()) / len(train) ** 0.5
        assert float(train.square().mean().sqrt()) > 1.8
        assert float(test.square().mean().sqrt()) > 1.8


def test_closed_loop_training_makes_the_free_run_better():
    series = drifting_record()
    error = {}
    for loop in ("open", "closed"):
        training = TrainingOptions(loop=loop, max_iterations=40, patience=10, starts=1, ridge=1e-4)
        options = PositionFitOptions(
            network=network(hidden=4), training=training, length=150, stride=50
        )
        fits = fit_position(series, options)
        free = run_on_own_output(fits, series, NAMES)
        error[loop] = float((free - series.target[1:]).square().mean().sqrt())
    assert error["closed"] < 0.5 * error["open"]


def drifting_record(length=1500) -> PositionSeries:
    generator = torch.Generator().manual_seed(4)
    t = torch.arange(length, dtype=torch.float64) / 50.0
    truth = torch.stack([8.0 * t, 5.0 * t + 0.1 * t**2, torch.sin(t)], -1)
    ins = truth + 0.03 * (t**2).unsqueeze(1)
    index = torch.arange(0, length, 10)
    noise = torch.randn(len(index), 3, generator=generator, dtype=torch.float64)
    return position_series(t, ins, index, truth[index] + noise)


def test_options_are_checked():
    training = TrainingOptions(loop="open")
    with pytest.raises(ConfigError, match="is not one of"):
        PositionFitOptions(network=network(), training=training, split="odd")
    with pytest.raises(ConfigError, match="expected 2 inputs"):
        PositionFitOptions(network=network(), training=training, inputs=NAMES[:2])
