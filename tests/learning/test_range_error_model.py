"""Range-error models against systems that are known, conditional Gaussians and plain loops."""

import math
from dataclasses import replace

import pytest
import torch

from navlearn.error_models.pci_fit import fit_pci
from navlearn.errors import ConfigError, FitError
from navlearn.learning.range_error_model import predict_range_errors
from navlearn.learning.range_error_options import RangeErrorOptions
from navlearn.learning.range_level import (
    GaussMarkov,
    fit_gauss_markov,
    last_values,
    predict_gauss_markov,
    recent_mean,
)
from navlearn.learning.range_residuals import ResidualSeries
from navlearn.learning.range_windows import emulated_outages, held_through_gaps, past_windows

ORIGIN, ROWS, SATELLITES = 300, 360, 3
EVERY = torch.ones(SATELLITES).bool()


def drawn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


def process(gm: GaussMarkov, series: int, rows: int, seed: int = 0) -> torch.Tensor:
    white = drawn(series, rows, seed=seed)
    state = math.sqrt(gm.variance) * white[:, 0]
    rest = math.sqrt(gm.variance * (1.0 - gm.correlation**2))
    path = [state]
    for k in range(1, rows):
        state = gm.correlation * state + rest * white[:, k]
        path.append(state)
    return torch.stack(path, -1)


def series_of(truth: torch.Tensor, inputs: torch.Tensor, noise: float = 0.0) -> ResidualSeries:
    """Residuals (T, S) that are known up to the origin, and inputs (T, S, m)."""
    target = truth + noise * drawn(*truth.shape, seed=9)
    target[ORIGIN:] = torch.nan
    return ResidualSeries(target, inputs, torch.arange(ROWS), ORIGIN, 1.0)


def moving(seed: int = 3) -> torch.Tensor:
    """Elevation and C/N0 of every satellite, (T, S, 2)."""
    slow = torch.tanh(process(GaussMarkov(1.0, 0.8, 0.0), 2 * SATELLITES, ROWS, seed=seed))
    base = torch.tensor([0.6, 42.0]).double()
    return base + torch.tensor([0.2, 4.0]).double() * slow.T.reshape(ROWS, SATELLITES, 2)


def remembered(inputs: torch.Tensor) -> torch.Tensor:
    """A range error that is a polynomial of C/N0 now and two rows ago, another per satellite."""
    x = (inputs[..., 1] - 42.0) / 4.0
    before = torch.cat((x[:1], x[:1], x[:-2]))
    size = torch.tensor([1.0, -2.0, 3.0]).double()
    mixed = 0.8 * x - 0.5 * before
    return size * (0.7 * mixed + 0.6 * mixed**2)


@pytest.mark.parametrize("structure", ["pci", "fos"])
def test_an_error_with_memory_is_recovered(structure: str) -> None:
    inputs = moving()
    truth = remembered(inputs)
    options = RangeErrorOptions(
        structure=structure, inputs=("elevation", "cn0"), lags=3, degree=2, output_limit=10.0
    )
    found = predict_range_errors(series_of(truth, inputs, noise=0.1), EVERY, options)
    left = (found.error - truth[ORIGIN:]).square().mean(0).sqrt()
    size = truth[ORIGIN:].square().mean(0).sqrt()
    assert bool((left < 0.25 * size).all())
    assert len(found.fitted) == SATELLITES
    assert found.fitted[0].record.source.acts_on == "pseudorange"


def test_anarx_learns_what_feeds_itself_back() -> None:
    inputs = moving()[..., 1:]
    x = (inputs[..., 0] - 42.0) / 4.0
    truth = torch.zeros(ROWS, SATELLITES).double()
    for k in range(1, ROWS):
        truth[k] = 0.8 * truth[k - 1] + torch.tanh(x[k])
    options = RangeErrorOptions(structure="anarx", inputs=("cn0",), lags=1, hidden=3)
    found = predict_range_errors(series_of(truth, inputs, noise=0.1), EVERY, options)
    left = (found.error - truth[ORIGIN:]).square().mean().sqrt()
    assert float(left) < 0.3 * float(truth[ORIGIN:].square().mean().sqrt())


def test_cascades_equal_a_fit_by_hand_and_one_step_after_the_other() -> None:
    inputs = moving()
    series = series_of(remembered(inputs), inputs, noise=0.5)
    series.target[200:204, 1] = torch.nan  # a gap, which no memory may reach across
    options = RangeErrorOptions(structure="pci", lags=2, window_s=250.0)
    found = predict_range_errors(series, torch.tensor([False, True, False]), options)
    assert found.known.tolist() == [False, True, False]
    assert bool((found.error[:, [0, 2]] == 0.0).all())
    y = series.target[ORIGIN - 250 : ORIGIN, 1]
    there = torch.isfinite(y)
    u = inputs[ORIGIN - 250 : ORIGIN, 1]
    model = fit_pci(u, torch.where(there, y, 0.0), options.pci_options(), there.double()).model
    state = model.initial_state(inputs[ORIGIN - 3, 1])  # type: ignore[operator]
    outputs = []
    for row in inputs[ORIGIN - 2 :, 1]:
        value, state = model.step(row, state)  # type: ignore[operator]
        outputs.append(value[0])
    torch.testing.assert_close(found.error[:, 1], torch.stack(outputs[2:]))


def test_one_model_for_all_satellites_pools_their_rows() -> None:
    inputs = moving()
    x = (inputs[..., 1] - 42.0) / 4.0
    options = RangeErrorOptions(structure="pci", shared=True, output_limit=10.0)
    series = series_of(1.5 * x**2 - 1.0, inputs, noise=1.0)
    found = predict_range_errors(series, torch.tensor([True, False, False]), options)
    assert len(found.fitted) == 1
    assert found.fitted[0].record.samples == SATELLITES * ORIGIN
    assert found.known.tolist() == [True, False, False]
    left = found.error[:, 0] - (1.5 * x**2 - 1.0)[ORIGIN:, 0]
    assert float(left.square().mean().sqrt()) < 0.3


def test_noise_gives_no_cascades_and_little_correction() -> None:
    """On white residuals nothing but the window's mean is left of the model."""
    inputs = moving()
    series = series_of(torch.zeros(ROWS, SATELLITES).double(), inputs, noise=2.0)
    found = predict_range_errors(series, EVERY, RangeErrorOptions(structure="pci", lags=3))
    assert sum(one.record.iterations for one in found.fitted) == 0
    assert float(found.error.abs().max()) < 4.0 * 2.0 / math.sqrt(ORIGIN)


def test_decay_finds_the_process_and_its_noise() -> None:
    true = GaussMarkov(4.0, math.exp(-1.0 / 40.0), 1.5)
    paths = process(true, 40, 2000, seed=5)
    found = fit_gauss_markov(paths + math.sqrt(1.5) * drawn(40, 2000, seed=6))
    assert found.variance == pytest.approx(4.0, rel=0.15)
    assert found.noise == pytest.approx(1.5, rel=0.15)
    assert -1.0 / math.log(found.correlation) == pytest.approx(40.0, rel=0.25)


def test_decay_equals_the_conditional_gaussian() -> None:
    gm = GaussMarkov(4.0, 0.9, 1.5)
    target = process(gm, 2, 12, seed=2)
    target[0, 5] = torch.nan
    times = torch.arange(12 + 4).double()
    joint = gm.variance * gm.correlation ** (times - times.unsqueeze(-1)).abs()
    level, variance = predict_gauss_markov(gm, target, 4)
    for k in range(2):
        seen = torch.nonzero(torch.isfinite(target[k])).squeeze(-1)
        measured = joint[seen][:, seen] + gm.noise * torch.eye(len(seen)).double()
        cross = joint[12:][:, seen]
        mean = cross @ torch.linalg.solve(measured, target[k, seen])
        left = joint[12:, 12:] - cross @ torch.linalg.solve(measured, cross.T)
        torch.testing.assert_close(level[k], mean)
        torch.testing.assert_close(variance[k], left.diagonal())


def test_held_is_the_last_residual_within_its_bounds() -> None:
    inputs = moving()
    series = series_of(drawn(ROWS, SATELLITES), inputs)
    series.target[ORIGIN - 1, 0] = 50.0
    series.target[ORIGIN - 1, 1] = torch.nan
    last = RangeErrorOptions(structure="held", average_s=0.0)
    found = predict_range_errors(series, EVERY, last)
    y = series.target[:ORIGIN, 0]
    assert float(found.error[0, 0]) == pytest.approx(
        float(y.mean() + 3.0 * y.std(correction=0)), rel=1e-6
    )
    assert bool((found.error[:, 1] == series.target[ORIGIN - 2, 1]).all())
    raw = predict_range_errors(series, EVERY, replace(last, bounds=False))
    assert bool((raw.error[:, 0] == 50.0).all())


def test_held_is_the_mean_of_the_last_residuals_where_asked() -> None:
    series = series_of(drawn(ROWS, SATELLITES), moving())
    series.target[ORIGIN - 2, 0] = torch.nan
    options = RangeErrorOptions(structure="held", average_s=20.0, window_s=100.0)
    found = predict_range_errors(series, EVERY, options)
    y = series.target[ORIGIN - 100 : ORIGIN, 0]
    weight = torch.exp(-torch.arange(100).double().flip(0) / 20.0) * torch.isfinite(y)
    mean = float((weight * y.nan_to_num()).sum() / weight.sum())
    assert found.error[:, 0].tolist() == pytest.approx([mean] * (ROWS - ORIGIN))


def test_emulated_outages_hold_what_was_known_at_their_starts() -> None:
    inputs = moving()
    series = series_of(drawn(ROWS, SATELLITES), inputs)
    options = RangeErrorOptions(
        inputs=("cn0", "recent", "delay"), emulated_s=20.0, window_s=100.0, average_s=10.0
    )
    seen = series._replace(inputs=inputs[..., 1:])
    windows = past_windows(seen, torch.arange(SATELLITES), options)
    cut = emulated_outages(windows, options)
    # the second outage of the third satellite starts in row 6 of the window
    which = int(torch.nonzero(cut.owner == 2)[1])
    y = series.target[ORIGIN - 100 : ORIGIN, 2]
    torch.testing.assert_close(cut.target[which], y[6:26])
    weight = torch.exp(-torch.arange(6).double().flip(0) / 10.0)
    mean = float((weight * y[:6]).sum() / weight.sum())
    assert cut.inputs[which, :, 1].tolist() == pytest.approx([mean] * 20)
    assert cut.inputs[which, :, 2].tolist() == [float(k) for k in range(1, 21)]
    torch.testing.assert_close(cut.inputs[which, :, 0], inputs[ORIGIN - 94 : ORIGIN - 74, 2, 1])


def test_cascades_on_recent_and_delay_learn_to_let_an_error_decay() -> None:
    gm = GaussMarkov(9.0, math.exp(-1.0 / 30.0), 0.0)
    truth = process(gm, SATELLITES, ROWS, seed=8).T
    inputs = torch.zeros(ROWS, SATELLITES, 0).double()
    options = RangeErrorOptions(
        inputs=("recent", "delay"), shared=True, average_s=2.0, degree=3, acceptance="paper"
    )
    found = predict_range_errors(series_of(truth, inputs, noise=0.1), EVERY, options)
    far = truth[ORIGIN - 1].abs() > 1.0
    assert int(far.sum()) == 2
    assert bool((found.error[0] * truth[ORIGIN - 1] > 0.0)[far].all())
    assert bool((found.error[0].abs() > 2.0 * found.error[-1].abs())[far].all())


def test_gaps_are_held_and_means_weighted() -> None:
    ahead = torch.tensor([math.nan, 2.0, math.nan]).double().reshape(1, 3, 1)
    before = torch.tensor([7.0, math.nan]).double().reshape(1, 2, 1)
    assert held_through_gaps(ahead, before).flatten().tolist() == [7.0, 2.0, 2.0]
    y = torch.tensor([[math.nan, 1.0, math.nan, 4.0]]).double()
    w = math.exp(-1.0 / 2.0) ** 2
    found = recent_mean(y, 2.0)[0].tolist()
    assert found == pytest.approx([math.nan, 1.0, 1.0, (w + 4.0) / (w + 1.0)], nan_ok=True)
    assert last_values(y).tolist() == [4.0]


def test_without_a_past_nothing_is_predicted() -> None:
    series = series_of(drawn(ROWS, SATELLITES), moving())
    series.target[: ORIGIN - 20] = torch.nan
    with pytest.raises(FitError, match="20 at most"):
        predict_range_errors(series, EVERY, RangeErrorOptions())


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"structure": "kriging"}, "choose one of"),
        ({"window_s": 0.5}, "at least a step"),
        ({"average_s": -1.0}, "must not be negative"),
        ({"inputs": ("recent",), "average_s": 0.0}, "a mean over more than 0 s"),
        ({"structure": "anarx", "inputs": ("recent",)}, "feeds its own output back"),
        ({"structure": "pci", "inputs": ()}, "at least one input"),
        ({"output_lags": 2}, "belong to fos"),
    ],
)
def test_options_say_what_is_wrong(changed: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        RangeErrorOptions(**changed)  # type: ignore[arg-type]
