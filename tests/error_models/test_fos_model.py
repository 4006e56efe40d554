import dataclasses
import json
import re

import pytest
import torch

from navlearn.error_models.base import ErrorModel, TrainingSource
from navlearn.error_models.fos import fos_description, fos_from_description
from navlearn.error_models.fos_equation import coefficient_unit, fitted_equation
from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.fos_options import FosOptions
from navlearn.errors import ConfigError, FitError, ShapeError


def record(rows=400, seed=0, noise=0.1):
    """Return inputs and an output that feeds itself back."""
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(rows, 2, generator=generator).double()
    e = noise * torch.randn(rows, generator=generator).double()
    y = torch.zeros(rows).double()
    for k in range(1, rows):
        y[k] = 0.6 * y[k - 1] + u[k, 0] - 0.5 * u[k - 1, 1] * u[k, 0] + e[k]
    return u, y.unsqueeze(1)


def fitted(output_lags=1, **options):
    u, y = record()
    return fit_fos(u, y, options=FosOptions(lags=1, output_lags=output_lags, **options)), u, y


def test_finds_the_system_and_its_noise():
    result, _, _ = fitted(seed=5)
    assert result.record.seed == 5
    assert set(result.model.terms) == {((2, 1),), ((0, 0),), ((0, 0), (1, 1))}
    found = dict(zip(result.model.terms, result.model.coefficients.tolist(), strict=True))
    assert found[((2, 1),)] == pytest.approx(0.6, abs=0.02)
    assert found[((0, 0), (1, 1))] == pytest.approx(-0.5, abs=0.02)
    by_step = result.model.variance[:, 0]
    assert float(by_step[0]) == pytest.approx(0.01, rel=0.8)
    settled = float(by_step[10:].mean())
    assert settled == pytest.approx(0.01 / (1 - 0.36), rel=0.25)
    assert result.record.samples == 399
    assert result.curves.train[0] > result.curves.train[-1] == result.record.train_loss


def test_variance_of_a_model_without_feedback_is_the_noise():
    generator = torch.Generator().manual_seed(2)
    u = torch.randn(4000, 2, generator=generator).double()
    y = 1.0 + u[:, :1] * u[:, 1:] + 0.3 * torch.randn(4000, 1, generator=generator).double()
    model = fit_fos(u, y).model
    assert float(model.prediction_variance(7)) == pytest.approx(0.09, rel=0.07)


@pytest.mark.parametrize("output_lags", [0, 1])
@pytest.mark.parametrize("safeguard", [False, True])
def test_step_equals_forward_and_scripted_equals_eager(output_lags, safeguard):
    result, u, _ = fitted(output_lags, safeguard=safeguard)
    model = result.model
    assert isinstance(model, ErrorModel)
    assert model.feedback == (output_lags == 1)
    window = 1.5 * u[:60].reshape(2, 30, 2)
    scripted = torch.jit.script(model)
    start = torch.tensor([[0.3], [-0.2]]).double()
    whole = model(window, start)
    torch.testing.assert_close(scripted(window, start), whole, rtol=0, atol=0)
    for runner in (model, scripted):
        state, outputs = runner.initial_state(window[:, 0], start), []
        for k in range(30):
            y, state = runner.step(window[:, k], state)
            outputs.append(y)
        torch.testing.assert_close(torch.stack(outputs, 1), whole, rtol=1e-12, atol=1e-12)
    assert state.shape == (2, model.memory, 3)


def test_warm_state_continues_a_record():
    result, u, y = fitted()
    model = result.model
    ahead, _ = model.step(u[100], model.warm_state(u[:100], y[:100]))
    expected = sum(
        value * torch.stack([torch.cat([u, y], 1)[100 - lag, c] for c, lag in term]).prod()
        for value, term in zip(model.coefficients.detach(), model.terms, strict=True)
    )
    torch.testing.assert_close(ahead[0], expected)


def test_memory_is_all_that_a_correction_depends_on():
    result, u, _ = fitted(0)
    model = result.model
    other = u.clone()
    other[: 50 - model.memory] += 1.0
    torch.testing.assert_close(model(u)[50:], model(other)[50:], rtol=0, atol=0)


def test_safeguard_clamps_and_limits():
    result, u, _ = fitted(0)
    model = result.model
    wild = u[:20] * 1e3
    assert torch.equal(model(wild), model(wild.clamp(model.u_low, model.u_high)))
    assert int(model.count_clamped(wild[3])) == 2
    assert bool(torch.isfinite(model(wild * torch.nan)).all())
    reach = 5.0 * model.y_scale
    assert bool(((model(wild) - model.y_mean).abs() <= reach * (1 + 1e-12)).all())


def test_equation_reads_as_the_model_does():
    result, _, _ = fitted()
    text = result.model.equation(("rate", "speed"), "error", ("rad/s", "m/s"), "rad")
    values = [f"{value:+.6g}" for value in result.model.coefficients.tolist()]
    assert text.startswith("error[k] = ")
    assert all(value in text for value in values)
    assert "s²/m · rate[k] · speed[k-1]" in text
    assert " s · rate[k]" in text
    assert re.search(r"[0-9] · error\[k-1\]", text)
    with pytest.raises(ConfigError):
        result.model.equation(("one",))


def test_windows_are_not_joined():
    u, y = record()
    windows = fit_fos(u.reshape(4, 100, 2), y.reshape(4, 100, 1)).record
    assert windows.samples == 4 * 99


def test_rows_of_weight_zero_are_not_read():
    u, y = record()
    weight = torch.ones(400).double()
    weight[200:] = 0.0
    spoilt = y.clone()
    spoilt[200:] = torch.nan
    options = FosOptions(lags=1)
    half = fit_fos(u[:200], y[:200], options=options).model
    other = fit_fos(u, spoilt, weight, options).model
    assert half.terms == other.terms
    torch.testing.assert_close(half.coefficients, other.coefficients)
    weight[201] = 1.0
    with pytest.raises(FitError):
        fit_fos(u, spoilt, weight, options)
    with pytest.raises(ShapeError):
        fit_fos(u, y[:, 0])


def test_white_noise_gives_a_model_that_says_zero():
    generator = torch.Generator().manual_seed(0)
    u = torch.randn(100, 2, generator=generator).double()
    y = torch.randn(100, 1, generator=generator).double()
    model = fit_fos(u, y).model
    assert model.terms == ()
    assert bool((torch.jit.script(model)(u) == 0).all())
    assert model.equation() == "y[k] = 0"


def test_fitted_equation_takes_names_and_units_from_the_record():
    generator = torch.Generator().manual_seed(0)
    u = torch.randn(200, 2, generator=generator).double()
    y = 0.01 * u[:, :1] + 0.02 * u[:, :1] * u[:, 1:]
    source = TrainingSource(
        acts_on="gyro_rate",
        inputs=("yaw_rate", "f_x"),
        outputs=("gyro_error",),
        input_units=("rad/s", "m/s²"),
    )
    fitted = fit_fos(u, y, source=source)
    text = fitted_equation(fitted)
    assert text.startswith("gyro_error[k] = ")
    assert "+0.01 · yaw_rate[k]" in text
    assert "+0.02 s²/m · yaw_rate[k] · f_x[k]" in text
    bare = fit_fos(u, y, source=dataclasses.replace(source, input_units=()))
    assert "+0.02 · yaw_rate[k] · f_x[k]" in fitted_equation(bare)
    known = {"yaw_rate": "deg/s", "f_x": "m/s²", "speed": "m/s"}
    assert "+0.01 rad/deg · yaw_rate[k]" in fitted_equation(bare, known)
    assert "+0.01 1/deg · yaw_rate[k]" in fitted_equation(bare, known, "1/s")
    assert " · u1[k]" in fitted_equation(fit_fos(u, y))


@pytest.mark.parametrize(
    ("output", "factors", "unit"),
    [
        ("rad/s", [], "rad/s"),
        ("rad/s", ["rad/s"], ""),
        ("rad/s", ["rad/s", "rad/s"], "s/rad"),
        ("rad", ["m/s²", "m/s²"], "rad·s⁴/m²"),
        ("1", ["rad/s", "m/s²"], "s³/(rad·m)"),
        ("rad per step", ["60 s"], "rad/(step·(60 s))"),
        ("", ["1"], ""),
    ],
)
def test_unit_of_a_coefficient(output, factors, unit):
    assert coefficient_unit(output, factors) == unit


@pytest.mark.parametrize("output_lags", [0, 1])
def test_rebuilt_from_json_and_weights_predicts_the_same(output_lags):
    result, u, _ = fitted(output_lags, ridge=1e-6)
    model = result.model
    description = json.loads(json.dumps(fos_description(model)))
    other = fos_from_description(description, model.state_dict())
    assert other.options == result.options
    assert other.terms == model.terms
    assert torch.equal(other(u[:50] * 2.0), model(u[:50] * 2.0))
    assert torch.equal(other.variance, model.variance)
    assert other.equation() == model.equation()


@pytest.mark.parametrize(
    "change",
    [
        {"terms": []},
        {"terms": [[[0, 9]], [[0, 0]], [[0, 0], [1, 1]]]},
        {"terms": [[[7, 0]]]},
        {"terms": [[[0, 0]], [[2, 1]], [[0, 0], [1, 0]]]},
        {"terms": "none"},
        {"options": {"lags": 1, "colour": 3}},
        {"options": {"lags": -1}},
        {"inputs": None},
    ],
)
def test_a_wrong_description_is_refused(change):
    model = fitted()[0].model
    with pytest.raises(ConfigError):
        fos_from_description({**fos_description(model), **change}, model.state_dict())
