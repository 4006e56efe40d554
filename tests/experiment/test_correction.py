"""What a model says is taken off with the right sign, frame and time: models that know all."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.experiment.baselines import filter_options
from navlearn.experiment.correction import (
    correct,
    predict,
    regressors_through,
    without_predicted_position_error,
)
from navlearn.experiment.drive import timeline_of
from navlearn.learning.pseudo_outages import (
    PseudoOutageOptions,
    PseudoOutages,
    emulate_outages,
    error_increments,
)
from navlearn.logs.drive_log import DriveLog
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.recipe import AnarxSpec, Recipe
from navlearn.states import RissSample, Trajectory

MakeRecipe = Callable[..., Recipe]


class Knows(nn.Module):
    """An error model that returns what it was given, whatever it is asked."""

    def __init__(self, increments: Tensor) -> None:
        super().__init__()
        self.increments = increments

    def forward(self, u: Tensor) -> Tensor:
        assert u.shape[:-1] == self.increments.shape[:-1]
        return self.increments


def fitted(model: nn.Module) -> FittedErrorModel:
    record = TrainingRecord(
        source=TrainingSource(), time_span=(0.0, 1.0), samples=1, validation_samples=0,
        trainer="lm", loop="closed", iterations=0, stopped="", seed=0, train_loss=0.0,
        valid_loss=0.0, versions=(),
    )  # fmt: skip
    curves = TrainingCurves(train=(), valid=())
    return FittedErrorModel(kind="anarx", model=model, options=None, record=record, curves=curves)


@pytest.fixture(scope="module")
def navigator(make_recipe: MakeRecipe) -> Navigator:
    return Navigator(NavigatorOptions(filter=filter_options(make_recipe())))


@pytest.fixture(scope="module")
def outages(navigator: Navigator, make_recipe: MakeRecipe, short_drive: DriveLog) -> PseudoOutages:
    line = timeline_of(short_drive, make_recipe())
    run = navigator.run(line.samples, line.fixes, line.timing)
    spoilt = run._replace(samples=run.samples._replace(yaw_rate=1.1 * run.samples.yaw_rate + 0.002))
    return emulate_outages(navigator, spoilt, PseudoOutageOptions(horizon=30.0))


def spec(acts_on: str) -> AnarxSpec:
    return AnarxSpec.model_validate({"name": "knows", "acts_on": acts_on, "inputs": ["yaw_rate"]})


def errors(outages: PseudoOutages, better: Trajectory, acts_on: str) -> Tensor:
    """Total error at the ends of the steps."""
    return error_increments(outages._replace(predicted=better), acts_on).cumsum(-2)


def test_the_exact_azimuth_model_leaves_no_azimuth_error(
    navigator: Navigator, outages: PseudoOutages
) -> None:
    exact = fitted(Knows(error_increments(outages, "azimuth_rate")))
    better = correct(exact, spec("azimuth_rate"), navigator, outages)
    before = errors(outages, outages.predicted, "azimuth_rate").abs().amax((1, 2))
    after = errors(outages, better, "azimuth_rate").abs().amax((1, 2))
    assert before.mean() > 0.05
    # A car that stands holds its azimuth, so there what is taken off the gyro has no effect.
    moving = (outages.samples.stationary.sum(-1) == 0) & (outages.samples.speed.amin(-1) > 1.0)
    assert int(moving.sum()) >= 3
    assert after[moving].max() < 2e-5  # the transport rate differs between the two paths
    assert (
        errors(outages, better, "position").norm(dim=-1).amax(-1).mean()
        < 0.2 * errors(outages, outages.predicted, "position").norm(dim=-1).amax(-1).mean()
    )


def test_the_exact_position_model_leaves_no_position_error(
    navigator: Navigator, outages: PseudoOutages
) -> None:
    exact = fitted(Knows(error_increments(outages, "position")))
    better = correct(exact, spec("position"), navigator, outages)
    assert errors(outages, outages.predicted, "position").norm(dim=-1).max() > 20.0
    assert errors(outages, better, "position").norm(dim=-1).max() < 0.02
    assert torch.equal(better.azimuth, outages.predicted.azimuth)


def test_an_unfinished_step_gets_its_share(outages: PseudoOutages) -> None:
    """Of 25 samples in steps of 10, the last five get half of what the third step says."""
    samples = RissSample(*(channel[0, :25] for channel in outages.samples))
    increments = torch.tensor([[10.0, 1.0], [20.0, 2.0], [30.0, 3.0]], dtype=torch.float64)
    found = predict(fitted(Knows(increments)), spec("position"), samples, 10)
    assert found.shape == (25, 2)
    assert found.sum(0).tolist() == pytest.approx([45.0, 4.5])
    assert found[:10, 0].tolist() == pytest.approx([1.0] * 10)
    rate = predict(fitted(Knows(increments[:, :1])), spec("azimuth_rate"), samples, 10)
    assert rate[:, 0].tolist() == pytest.approx([-10.0] * 10 + [-20.0] * 10 + [-30.0] * 5)


def test_regressors_of_whole_steps_are_those_of_training(outages: PseudoOutages) -> None:
    inputs = ("yaw_rate", "delay")
    samples = RissSample(*(channel[0] for channel in outages.samples))
    whole = regressors_through(samples, inputs, 10)
    cut = RissSample(*(channel[:25] for channel in samples))
    part = regressors_through(cut, inputs, 10)
    assert part.shape == (3, 2)
    assert torch.equal(part[:2], whole[:2])
    expected = outages.samples.yaw_rate[0].unflatten(0, (-1, 10)).mean(-1)
    assert torch.allclose(whole[:, 0], expected, rtol=0.0, atol=1e-15)


def test_increments_are_in_the_frame_at_the_end_of_their_step() -> None:
    """A step that begins northward and ends eastward errs ahead: that is to the east."""
    zero = torch.zeros(4, dtype=torch.float64)
    azimuth = torch.tensor([0.0, torch.pi / 2, torch.pi / 2, 0.3], dtype=torch.float64)
    path = Trajectory(zero, zero, zero, azimuth, zero, zero, zero)
    ahead = torch.stack((zero + 1.0, zero), -1)
    better = without_predicted_position_error(path, ahead[:2].new_tensor(ahead.tolist()), 2)
    assert float(better.lon[1]) * 6_378_137.0 == pytest.approx(-2.0)
    assert float(better.lat[1]) * 6_378_137.0 == pytest.approx(0.0, abs=1e-9)
