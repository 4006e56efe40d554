import pytest
import torch

from navlearn.error_models.base import TrainingSource
from navlearn.error_models.fos_candidates import Candidates
from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_sliding import SlidingFos
from navlearn.errors import ConfigError, FitError, ShapeError


def stream(rows=400, seed=0, correlated=0.6):
    """Return inputs and an output whose law changes half-way."""
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(rows, 3, generator=generator).double()
    for k in range(1, rows):
        u[k] = correlated * u[k - 1] + (1.0 - correlated**2) ** 0.5 * u[k]
    y = 0.3 * torch.randn(rows, generator=generator).double()
    half = rows // 2
    y[1:half] += u[1:half, 0] - 0.5 * u[: half - 1, 1] * u[1:half, 2] + 0.2
    y[half:] += 0.7 * u[half - 1 : -1, 2] + 0.4 * u[half:, 0] ** 2
    return u, y.unsqueeze(1)


def assert_same(found, expected):
    terms = dict(zip(expected.model.terms, expected.model.coefficients.tolist(), strict=True))
    assert found.model.terms == expected.model.terms
    assert dict(
        zip(found.model.terms, found.model.coefficients.tolist(), strict=True)
    ) == pytest.approx(terms, rel=1e-9)
    assert found.record.stopped == expected.record.stopped
    assert found.record.samples == expected.record.samples
    assert found.curves.train == pytest.approx(expected.curves.train, rel=1e-9)
    torch.testing.assert_close(found.model.variance, expected.model.variance, rtol=1e-9, atol=0)
    for name in ("u_mean", "u_low", "u_high", "y_scale"):
        assert torch.equal(getattr(found.model, name), getattr(expected.model, name))


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"degree": 1, "output_lags": 2},
        {"ridge": 0.02, "false_alarm": 1.0},
        {"exchange_sweeps": 5, "backward": True},
        {"exchange_sweeps": 2, "kicks": 2, "max_terms": 5},
        {"lags": 0, "acceptance": "paper", "max_terms": 4},
        {"lags": 6, "max_terms": 10, "false_alarm": 1.0},
    ],
)
def test_sliding_fit_equals_a_fit_of_the_window(changed):
    options = FosOptions(**{"lags": 2, **changed})
    u, y = stream()
    weight = 0.1 + torch.rand(400, generator=torch.Generator().manual_seed(1)).double()
    weight[torch.arange(400) % 17 == 3] = 0.0
    y = torch.where((weight > 0).unsqueeze(1) | (options.output_lags > 0), y, torch.nan)
    sliding, seen = SlidingFos(3, 80, options, TrainingSource(time_step=0.1)), 0
    chosen = set()
    for count in [50, 20, 20, 1, 1, 5, 10, 10, 30, 2, 90, 7, 100, 1, 40]:
        rows = slice(seen, seen + count)
        sliding.push(u[rows], y[rows], weight[rows])
        seen += count
        last = slice(max(0, seen - 80), seen)
        expected = fit_fos(u[last], y[last], weight[last], options, TrainingSource(time_step=0.1))
        found = sliding.fit()
        assert_same(found, expected)
        assert found.record.time_span == expected.record.time_span
        chosen.add(frozenset(found.model.terms))
    assert len(chosen) > 1


def sums_apart(sliding):
    """Return the largest share by which the carried sums differ from sums built anew."""
    sums = sliding._sums
    window: Candidates = sums.window
    target = sliding._slice(*sliding._summed)[-2:-1]
    energies = window.energies()[0]
    size = energies.clamp(min=1e-300).sqrt()
    apart = [((sums.energies - energies).abs() / energies.clamp(min=1e-300)).max()]
    norm = (window.weight * target**2).sum().sqrt()
    apart.append(((sums.cross - window.correlations(target)[0]).abs() / size).max() / norm)
    for place, row in sums.rows.items():
        fresh = window.gram_rows(torch.tensor([place]))[0]
        apart.append(((row - fresh).abs() / size).max() / size[place])
    return float(max(apart))


def test_sums_do_not_drift_over_many_slides():
    u, y = stream(rows=3000)
    sliding, worst = SlidingFos(3, 60, FosOptions(lags=1)), 0.0
    sliding.push(u[:60], y[:60])
    for k in range(60, 3000):
        sliding.push(u[k : k + 1], y[k : k + 1])
        if k % 10 == 0:
            sliding.fit()
            worst = max(worst, sums_apart(sliding))
    assert 0.0 < worst < 1e-11


def test_sums_forget_what_was_huge():
    u, y = stream(rows=300)
    u[100:110] *= 1e5
    y[120:123] *= 1e6
    u[200:] *= 1e-7
    sliding, options = SlidingFos(3, 40, FosOptions(lags=1)), FosOptions(lags=1)
    for k in range(0, 300, 4):
        sliding.push(u[k : k + 4], y[k : k + 4])
        found = sliding.fit()
        assert sums_apart(sliding) < 1e-8
        last = slice(max(0, k - 36), k + 4)
        assert_same(found, fit_fos(u[last], y[last], options=options))


def test_only_rows_that_changed_are_summed():
    u, y = stream()
    sliding = SlidingFos(3, 100, FosOptions(lags=1))
    sliding.push(u[:100], y[:100])
    sliding.fit()
    anchored = sliding._sums.slid
    sliding.push(u[100:110], y[100:110])
    sliding.fit()
    assert (anchored, sliding._sums.slid) == (0, 20)


def test_rows_between_fits_may_be_more_than_the_window():
    u, y = stream()
    sliding = SlidingFos(3, 30)
    for rows in (slice(0, 40), slice(40, 250), slice(250, 251), slice(251, 400)):
        sliding.push(u[rows], y[rows])
        last = slice(rows.stop - 30, rows.stop)
        assert_same(sliding.fit(), fit_fos(u[last], y[last]))
    assert len(sliding) == 30


def test_a_row_that_is_not_finite_is_refused_until_it_has_left():
    u, y = stream()
    spoilt = u.clone()
    spoilt[100, 1] = torch.nan
    sliding = SlidingFos(3, 40)
    sliding.push(spoilt[:90], y[:90])
    sliding.fit()
    sliding.push(spoilt[90:110], y[90:110])
    for _ in range(2):
        with pytest.raises(FitError):
            sliding.fit()
    sliding.push(spoilt[110:142], y[110:142])
    assert_same(sliding.fit(), fit_fos(u[102:142], y[102:142]))
    weight = torch.ones(20).double()
    weight[5:7] = 0.0
    sliding.push(torch.where(torch.arange(20)[:, None] == 5, torch.nan, u[142:162]), y[142:162])
    with pytest.raises(FitError):
        sliding.fit()


def test_wrong_windows_are_refused():
    with pytest.raises(ConfigError):
        SlidingFos(2, 3, FosOptions(lags=3))
    sliding = SlidingFos(2, 30)
    with pytest.raises(ShapeError):
        sliding.fit()
    with pytest.raises(ShapeError):
        sliding.push(torch.zeros(4, 3), torch.zeros(4, 1))
    with pytest.raises(ShapeError):
        sliding.push(torch.zeros(4, 2), torch.zeros(4, 1), torch.zeros(3))
    sliding.push(torch.zeros(4, 2), torch.zeros(4, 1), torch.zeros(4))
    with pytest.raises(FitError):
        sliding.fit()
