"""Ridge models: terms by hand, the contract, the safeguard, and the way to disk and back."""

import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from navlearn.error_models.base import (
    ErrorModel,
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.gyro_terms import (
    PHYSICAL_TERMS,
    PRIOR_SIGMA,
    candidate_names,
    channels_of,
    prior_sigmas,
    product_terms,
)
from navlearn.error_models.ridge import RidgeModel, RidgeOptions, term_values
from navlearn.error_models.storage import load_error_model, save_error_model
from navlearn.errors import ConfigError, ShapeError

INPUTS = ("yaw_rate", "f_x", "f_y")
BIAS = 0.01


def channels(rows: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    scale = torch.tensor([0.3, 1.0, 0.5], dtype=torch.float64)
    return torch.randn(rows, 3, generator=generator, dtype=torch.float64) * scale


def ridge(*, safeguard: bool = True, limit: float = 5.0) -> RidgeModel:
    terms = product_terms(PHYSICAL_TERMS, INPUTS, BIAS)
    options = RidgeOptions(inputs=3, terms=PHYSICAL_TERMS, safeguard=safeguard, output_limit=limit)
    model = RidgeModel(options)
    theta = torch.tensor([0.02, -0.01, 0.015, 1e-3, -2e-3], dtype=torch.float64)
    model.set_fit(terms, theta, torch.diag(theta.square() * 0.01), channels(500))
    return model.eval()


def by_hand(u: Tensor) -> Tensor:
    rate = u[..., 0] - BIAS
    return torch.stack((rate, rate.abs(), rate * rate.abs(), u[..., 1], u[..., 2]), -1)


def test_physical_terms_are_those_of_the_textbook() -> None:
    terms = product_terms(PHYSICAL_TERMS, INPUTS, BIAS)
    u = channels(200)
    torch.testing.assert_close(term_values(u, terms.form, terms.magnitude), by_hand(u))


def test_correction_is_their_sum_inside_the_training_range() -> None:
    model = ridge(limit=1e3)
    u = channels(500)
    expected = (by_hand(u) * model.coefficients).sum(-1, keepdim=True)
    torch.testing.assert_close(model(u), expected, rtol=1e-12, atol=1e-15)


def test_steps_equal_forward_and_scripted_equals_eager() -> None:
    model = ridge()
    assert isinstance(model, ErrorModel)
    u = channels(50, seed=1) * 3.0
    windows = u.reshape(5, 10, 3)
    state = model.initial_state(windows[:, 0])
    steps = []
    for k in range(10):
        y, state = model.step(windows[:, k], state)
        steps.append(y)
    assert torch.equal(torch.stack(steps, 1), model(windows))
    with pytest.warns(DeprecationWarning, match="script"):
        scripted = torch.jit.script(model)
    assert torch.equal(scripted(windows), model(windows))
    assert torch.equal(scripted.prediction_variance(3), model.prediction_variance(3))


def test_inputs_outside_training_are_held_and_counted() -> None:
    model = ridge(limit=1e3)
    far = torch.tensor([[100.0, 0.0, 0.0], [0.1, 0.0, math.nan]], dtype=torch.float64)
    held = far.clone()
    held[0, 0] = channels(500)[:, 0].max()
    held[1, 2] = channels(500)[:, 2].mean()
    assert model.count_clamped(far).tolist() == [1, 1]
    torch.testing.assert_close(model(far), ridge(safeguard=False)(held), rtol=1e-12, atol=0.0)


def test_correction_stays_within_its_spread() -> None:
    u = channels(500)
    free = ridge(safeguard=False)(u)
    limited = ridge(limit=1.5)(u)
    low, high = (free.mean() + sign * 1.5 * free.std(correction=0) for sign in (-1.0, 1.0))
    torch.testing.assert_close(limited, free.clamp(low, high), rtol=1e-12, atol=1e-15)
    assert (limited != free).any()


def test_prediction_variance_is_that_of_drawn_coefficients() -> None:
    model = ridge()
    generator = torch.Generator().manual_seed(3)
    draws = torch.randn(4000, 5, generator=generator, dtype=torch.float64)
    theta = draws * model.covariance.diagonal().sqrt()
    spread = (by_hand(channels(500)) @ theta.T).square().mean()
    assert float(model.prediction_variance(1)) == pytest.approx(float(spread), rel=0.05)


def test_a_model_without_terms_corrects_nothing() -> None:
    model = RidgeModel(RidgeOptions(inputs=3, terms=()))
    none = torch.zeros(0, dtype=torch.float64)
    model.set_fit(product_terms((), INPUTS, 0.0), none, none.reshape(0, 0), channels(10))
    assert torch.equal(model(channels(20) * 10.0), torch.zeros(20, 1, dtype=torch.float64))


def test_to_disk_and_back(tmp_path: Path) -> None:
    model = ridge()
    record = TrainingRecord(
        source=TrainingSource(acts_on="gyro_rate", inputs=INPUTS, outputs=("error",)),
        time_span=(0.0, 50.0), samples=500, validation_samples=0, trainer="ridge", loop="open",
        iterations=1, stopped="closed form", seed=0, train_loss=1.0, valid_loss=0.5,
        versions=(("torch", "2"),),
    )  # fmt: skip
    fitted = FittedErrorModel(
        kind="ridge", model=model, options=model.options, record=record,
        curves=TrainingCurves(train=(1.0,), valid=()),
    )  # fmt: skip
    save_error_model(fitted, tmp_path / "ridge.pt")
    again = load_error_model(tmp_path / "ridge.pt")
    u = channels(50, seed=2) * 4.0
    assert torch.equal(again.model(u), model(u))
    assert again.options == model.options
    assert again.record == record
    assert again.kind == "ridge"


def test_candidates_are_all_products_once() -> None:
    names = candidate_names(("a", "abs_a", "b"), 2)
    assert names == ("a", "abs_a", "b", "a*a", "a*abs_a", "a*b", "abs_a*b", "b*b")
    assert candidate_names(("a", "b"), 1) == ("a", "b")
    assert channels_of(names) == ("a", "b")


def test_priors_are_physical_or_made_of_a_stated_rate_error() -> None:
    spread = torch.tensor([0.1, 4.0, 0.0], dtype=torch.float64)
    found = prior_sigmas(("yaw_rate", "speed", "f_x*f_x"), spread, PRIOR_SIGMA, 0.002)
    assert found.tolist() == pytest.approx([0.03, 0.002 / 4.0, 0.002])


def test_coefficients_are_told_in_units_that_are_known() -> None:
    told = ridge().readable_coefficients()
    assert told["yaw_rate"] == "+2 ± 0.2 %"
    assert told["f_x"] == "+0.562 ± 0.056 deg/s per g"


@pytest.mark.parametrize("name", ["wheel", "yaw_rate*abs_wheel", "f_x*f_x*f_x"])
def test_unknown_terms_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="gyro term"):
        product_terms((name,), INPUTS, 0.0)


def test_wrong_shapes_and_options_are_refused() -> None:
    model = RidgeModel(RidgeOptions(inputs=3, terms=("f_x",)))
    terms = product_terms(("f_x", "f_y"), INPUTS, 0.0)
    two = torch.zeros(2, dtype=torch.float64)
    with pytest.raises(ShapeError, match="forms have shape"):
        model.set_fit(terms, two, torch.zeros(2, 2), channels(4))
    with pytest.raises(ConfigError, match="inputs is 0"):
        RidgeOptions(inputs=0, terms=())
    with pytest.raises(ConfigError, match="output_limit"):
        RidgeOptions(inputs=1, terms=(), output_limit=0.0)
