"""Gyro-rate errors learned on a simulated drive whose coefficients are known."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from navlearn.error_models.base import TrainingSource
from navlearn.error_models.gyro_terms import GyroTerms
from navlearn.error_models.pci_options import PciOptions
from navlearn.error_models.ridge import term_values
from navlearn.errors import FitError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.azimuth_regression import AzimuthNoise
from navlearn.learning.gyro_cascades import cascade_terms, smoothed_rate_error
from navlearn.learning.gyro_past import (
    GyroPast,
    GyroRateOptions,
    averaged_channels,
    gyro_past,
    past_curve,
)
from navlearn.learning.gyro_rate import GyroFit
from navlearn.learning.gyro_structures import fit_gyro_rate, model_inputs
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.navigator import Navigator, NavigatorOptions, NavigatorRun
from navlearn.states import RissSample

SOURCE = TrainingSource(acts_on="gyro_rate")
TRUE_SCALE, TRUE_ASYMMETRY = 0.04, -0.012


@pytest.fixture(scope="module")
def run() -> NavigatorRun:
    """A drive whose gyro is perfect but for a scale factor and an asymmetry put in by hand."""
    drive = simulate_drive(
        profile="mixed", grade="tactical", duration=900.0, seed=12, imu_rate_hz=10.0, name="known"
    )
    line = riss_timeline(drive.log, rate_hz=10.0, dims=3)
    rate = line.samples.yaw_rate
    wrong = rate + TRUE_SCALE * rate + TRUE_ASYMMETRY * rate.abs()
    navigator = Navigator(NavigatorOptions(filter=EkfOptions()))
    return navigator.run(line.samples._replace(yaw_rate=wrong), line.fixes, line.timing)


def past_of(run: NavigatorRun, options: GyroRateOptions, end: int | None = None) -> GyroPast:
    stop = len(run.samples.dt) if end is None else end
    return gyro_past(run, EkfOptions(), model_inputs(options), options.average, stop)


def coefficients(fit: GyroFit) -> dict[str, float]:
    model = fit.fitted.model
    names: tuple[str, ...] = fit.fitted.options.terms
    return dict(zip(names, model.get_buffer("coefficients").tolist(), strict=True))


def true_error(samples: RissSample) -> Tensor:
    """What was put in, by the rate that the wrong gyro shows."""
    low, high = 1.0 + TRUE_SCALE - TRUE_ASYMMETRY, 1.0 + TRUE_SCALE + TRUE_ASYMMETRY
    shown = samples.yaw_rate
    return shown - torch.where(shown > 0, shown / high, shown / low)


def told(fit: GyroFit, past: GyroPast) -> Tensor:
    with torch.no_grad():
        found: Tensor = fit.fitted.model(past.u)[:, 0]
    return found


def unexplained(fit: GyroFit, past: GyroPast) -> float:
    """Share of the error, beside a constant, that is left."""
    true = true_error(past.run.samples)
    left = true - told(fit, past)
    return float(left.var() / true.var())


def test_known_coefficients_are_found_within_their_covariance(run: NavigatorRun) -> None:
    options = GyroRateOptions()
    past = past_of(run, options)
    (fit,) = fit_gyro_rate(past, options, [past.end], SOURCE)
    # by the rate shown: ω_shown − ω = ω_shown (1 − 1 / (1 + a)) on each side
    up, down = (1.0 - 1.0 / (1.0 + TRUE_SCALE + s * TRUE_ASYMMETRY) for s in (1.0, -1.0))
    true = torch.tensor([0.5 * (up + down), 0.5 * (up - down), 0.0, 0.0, 0.0]).double()
    model = fit.fitted.model
    off = model.get_buffer("coefficients") - true
    nees = float(off @ torch.linalg.solve(model.get_buffer("covariance"), off))
    assert nees < 20.5  # chi-square with 5 degrees, 99.9 %
    assert unexplained(fit, past) < 0.1


@pytest.mark.parametrize("structure", ["fos", "pci"])
def test_found_terms_explain_the_error(run: NavigatorRun, structure: str) -> None:
    options = GyroRateOptions(structure=structure)  # type: ignore[arg-type]
    past = past_of(run, options)
    (fit,) = fit_gyro_rate(past, options, [past.end], SOURCE)
    assert unexplained(fit, past) < 0.1
    assert 1 <= len(coefficients(fit)) <= 18
    assert fit.fitted.record.trainer == structure


def test_fos_finds_the_terms_that_were_put_in(run: NavigatorRun) -> None:
    options = GyroRateOptions(structure="fos", max_terms=2)
    past = past_of(run, options)
    (fit,) = fit_gyro_rate(past, options, [past.end], SOURCE)
    found = coefficients(fit)
    assert "yaw_rate" in found
    assert found["yaw_rate"] == pytest.approx(TRUE_SCALE / (1.0 + TRUE_SCALE), abs=0.006)


@pytest.mark.parametrize("structure", ["ridge", "fos", "pci"])
def test_an_origin_sees_nothing_of_what_follows(run: NavigatorRun, structure: str) -> None:
    options = GyroRateOptions(structure=structure)  # type: ignore[arg-type]
    ends = run.history.end
    first, second = (int(ends[k]) + 1 for k in (350, 600))
    along = past_of(run, options, second)
    early, late = fit_gyro_rate(along, options, [first, second], SOURCE)
    (alone,) = fit_gyro_rate(past_of(run, options, first), options, [first], SOURCE)
    a, b = coefficients(early), coefficients(alone)
    assert a.keys() == b.keys()
    for name, value in b.items():
        assert a[name] == pytest.approx(value, rel=1e-7)
    assert early.fitted.record.samples < late.fitted.record.samples
    if structure == "ridge":
        torch.testing.assert_close(early.azimuth, alone.azimuth, rtol=0.0, atol=1e-9)
        torch.testing.assert_close(early.gyro_bias, alone.gyro_bias, rtol=0.0, atol=1e-12)


def test_azimuth_and_bias_at_the_origin_are_those_of_the_corrected_gyro(
    run: NavigatorRun,
) -> None:
    """A second regression on the corrected gyro, without terms, ends with the same two."""
    options = GyroRateOptions(output_limit=1e6)
    past = past_of(run, options)
    (fit,) = fit_gyro_rate(past, options, [past.end], SOURCE)
    corrected = run.samples.yaw_rate.clone()
    corrected[: past.end] -= told(fit, past)
    again = past._replace(run=run._replace(samples=run.samples._replace(yaw_rate=corrected)))
    none = replace(options, terms=())
    (second,) = fit_gyro_rate(again, none, [past.end], SOURCE)
    turn = run.history.belief.state.azimuth[-1]
    # the raw curve of that past is still the filter's: what was corrected is taken off by hand
    moved = run.samples.dt * (1.0 - run.samples.stationary)
    shift = (told(fit, past) * moved[: past.end])[int(run.history.end[0]) + 1 :].sum()
    assert abs(float(fit.azimuth - turn)) < 0.02
    assert abs(float(second.azimuth - turn)) < 0.2 + abs(float(shift))
    assert float(fit.covariance[0, 0]) > 0.0
    assert float(fit.covariance[1, 1]) > 0.0


def test_a_gyro_without_deterministic_error_gets_next_to_no_terms_from_fos() -> None:
    drive = simulate_drive(
        profile="mixed", grade="tactical", duration=700.0, seed=13, imu_rate_hz=10.0, name="none"
    )
    line = riss_timeline(drive.log, rate_hz=10.0, dims=3)
    navigator = Navigator(NavigatorOptions(filter=EkfOptions()))
    run = navigator.run(line.samples, line.fixes, line.timing)
    options = GyroRateOptions(structure="fos")
    past = past_of(run, options)
    (fit,) = fit_gyro_rate(past, options, [past.end], SOURCE)
    assert len(coefficients(fit)) <= 1


def test_a_smoothed_rate_follows_the_error(run: NavigatorRun) -> None:
    options = GyroRateOptions()
    past = past_of(run, options)
    curve = past_curve(past, past.u[:, :0], options)
    rate, variance = smoothed_rate_error(curve, AzimuthNoise(), 2e-3)
    true = true_error(run.samples)[curve.end]
    assert float(torch.corrcoef(torch.stack((rate, true)))[0, 1]) > 0.7
    assert bool((variance > 0.0).all())


def test_powers_of_a_cascade_are_those_of_its_linear_element() -> None:
    generator = torch.Generator().manual_seed(8)
    x = torch.randn(600, 2, generator=generator, dtype=torch.float64)
    linear = 0.8 * x[:, 0] - 0.6 * x[:, 1]
    y = linear + 0.5 * linear**2
    search = PciOptions(inputs=2, lags=0, degree=2, cascades=1)
    terms = cascade_terms(x, y, torch.ones(600, dtype=torch.float64), search)
    assert terms.names == ("cascade_1", "cascade_1^2")
    values = term_values(x, terms.form, terms.magnitude)
    torch.testing.assert_close(values[:, 1], values[:, 0] ** 2)
    columns = torch.cat((values, torch.ones(600, 1, dtype=torch.float64)), -1)
    solution = torch.linalg.lstsq(columns, y.unsqueeze(-1)).solution
    left = y - (columns @ solution)[:, 0]
    assert float(left.var() / y.var()) < 0.02


def test_no_cascade_is_no_term() -> None:
    generator = torch.Generator().manual_seed(9)
    x = torch.randn(300, 2, generator=generator, dtype=torch.float64)
    y = torch.randn(300, generator=generator, dtype=torch.float64)
    terms = cascade_terms(x, y, torch.ones(300).double(), PciOptions(inputs=2, lags=0, degree=2))
    assert isinstance(terms, GyroTerms)
    assert terms.names == ()
    assert terms.form.shape == (0, 2, 3)


def test_averages_fill_up_the_last_row() -> None:
    one = torch.arange(7, dtype=torch.float64)
    samples = RissSample(torch.full_like(one, 0.1), *(one for _ in range(7)))
    found = averaged_channels(samples, ("yaw_rate",), 3)
    assert found[:, 0].tolist() == pytest.approx([1.0, 4.0, 6.0])


def test_no_past_is_refused(run: NavigatorRun) -> None:
    options = GyroRateOptions()
    with pytest.raises(FitError):
        fit_gyro_rate(past_of(run, options, 3), options, [3], SOURCE)
