import numpy as np
import pytest
import torch
from scipy.stats import beta

from navlearn.error_models.fos_candidates import Candidates, factor_list, lagged_columns
from navlearn.error_models.fos_fit import fit_fos, fit_fos_batch
from navlearn.error_models.fos_level import accepted_share, noise_level
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.fos_outcome import read_outcomes
from navlearn.error_models.fos_refine import exchange_terms, kick_terms, search_backward
from navlearn.error_models.fos_search import search_forward, start_search
from navlearn.errors import ConfigError, ShapeError


def record(rows=200, inputs=3, seed=0, correlated=0.0):
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(rows, inputs, generator=generator).double()
    for k in range(1, rows):
        u[k] = correlated * u[k - 1] + (1 - correlated**2) ** 0.5 * u[k]
    y = 0.7 * u[:, 0] - 0.4 * u[:, 1] * u[:, 2] + 0.3 * u[:, 1].roll(2) * u[:, 1] + 0.2
    return u, y + 0.3 * torch.randn(rows, generator=generator).double()


def matrix(u, y, options):
    """Every candidate as a column, by NumPy, with its pair of factors."""
    memory, rows = max(options.lags, options.output_lags), u.shape[0]
    columns = [np.ones(rows - memory)]
    for lag in range(options.lags + 1):
        columns += [u[memory - lag : rows - lag, c].numpy() for c in range(u.shape[1])]
    for lag in range(1, options.output_lags + 1):
        columns.append(y[memory - lag : rows - lag].numpy())
    count = len(columns)
    pairs = [(i, j) for i in range(count) for j in range(i, count)]
    if options.degree == 1:
        pairs = [(0, j) for j in range(count)]
    return np.stack([columns[i] * columns[j] for i, j in pairs], 1), pairs


def explicit_search(p, pairs, y, weight, terms, ridge=0.0):
    """Gram–Schmidt over all candidates, held; returns chosen pairs, errors and coefficients."""
    root = np.sqrt(weight)
    full, target = p * root[:, None], y * root
    if ridge > 0:
        own = np.sqrt(ridge) * np.linalg.norm(full, axis=0)
        own[0] = 0.0
        full = np.vstack([full, np.diag(own)])
        target = np.append(target, np.zeros(p.shape[1]))
    w, residual, chosen, errors = full.copy(), target.copy(), [], [target @ target]
    for _ in range(terms):
        energy = (w**2).sum(0)
        gain = np.where(energy > 1e-9 * (full**2).sum(0), (w.T @ residual) ** 2, 0.0)
        gain = np.where(gain > 0, gain / np.where(gain > 0, energy, 1.0), 0.0)
        best = int(np.argmax(gain))
        q = w[:, best] / np.linalg.norm(w[:, best])
        residual -= q * (q @ residual)
        for _ in range(2):
            w -= np.outer(q, q @ w)
        chosen.append(best)
        errors.append(residual @ residual)
    theta = np.linalg.lstsq(full[:, chosen], target, rcond=None)[0]
    return [pairs[k] for k in chosen], errors, theta


class Found:
    """A search over one window, its terms as pairs of columns."""

    def __init__(self, u, y, options, weight=None):
        x = lagged_columns(u, y, options)
        self.target = y[max(options.lags, options.output_lags) :].unsqueeze(0)
        weight = torch.ones_like(self.target) if weight is None else weight.unsqueeze(0)
        self.candidates = Candidates(x.unsqueeze(0), weight, options.degree)
        self.search = start_search(
            self.candidates.gram_rows,
            self.candidates.energies(),
            self.candidates.correlations(self.target),
            (weight * self.target**2).sum(1),
            weight,
            options,
        )
        search_forward(self.search)
        self.columns = x.shape[0]

    @property
    def outcome(self):
        return read_outcomes(self.search, self.candidates, self.target)[0]

    @property
    def chosen(self):
        return [divmod(k, self.columns) for k in self.outcome.chosen]

    @property
    def errors(self):
        return self.outcome.errors

    def table(self, values):
        return values[0].reshape(-1, self.columns)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("ridge", [0.0, 0.05])
@pytest.mark.parametrize("correlated", [0.0, 0.95])
def test_search_equals_explicit_gram_schmidt(degree, ridge, correlated):
    options = FosOptions(
        lags=2, output_lags=1, degree=degree, max_terms=6, false_alarm=1.0, ridge=ridge
    )
    u, y = record(correlated=correlated)
    weight = torch.rand(198, generator=torch.Generator().manual_seed(5)).double() + 0.1
    search = Found(u, y, options, weight)
    p, pairs = matrix(u, y, options)
    chosen, errors, theta = explicit_search(p, pairs, y[2:].numpy(), weight.numpy(), 6, ridge)
    assert search.chosen == chosen
    np.testing.assert_allclose(search.errors, errors, rtol=1e-9)
    np.testing.assert_allclose(search.outcome.coefficients, theta, rtol=1e-9)


def test_tables_after_the_search_equal_projection():
    options = FosOptions(lags=3, max_terms=5, false_alarm=1.0)
    u, y = record()
    search = Found(u, y, options)
    p, pairs = matrix(u, y, options)
    index = [pairs.index(pair) for pair in search.chosen]
    q = np.linalg.qr(p[:, index])[0]
    outside = p - q @ (q.T @ p)
    energy, corr = (search.table(t) for t in (search.search.energy, search.search.corr))
    expected = (outside**2).sum(0)
    found = [float(energy[pair]) for pair in pairs]
    np.testing.assert_allclose(found, expected, atol=1e-9 * expected.max())
    found = [float(corr[pair]) for pair in pairs]
    np.testing.assert_allclose(found, outside.T @ y[3:].numpy(), atol=1e-9)


def test_factors_name_the_columns():
    options = FosOptions(lags=1, output_lags=2)
    u, y = record(rows=9)
    x = lagged_columns(u, y, options)
    for row, factor in zip(x, factor_list(3, options), strict=True):
        expected = torch.ones(7).double()
        for channel, lag in factor:
            expected = (y if channel == 3 else u[:, channel])[2 - lag : 9 - lag]
        assert torch.equal(row, expected)


@pytest.mark.parametrize("candidates", [1, 500, 6216])
@pytest.mark.parametrize("rows", [30, 600])
def test_noise_level_is_the_beta_quantile(rows, candidates):
    single = 1.0 - 0.95 ** (1.0 / candidates)
    expected = beta.isf(single, 0.5, 0.5 * (rows - 3 - 1))
    assert noise_level(rows, 3, candidates, 0.05) == pytest.approx(expected, rel=0.01)


def accepted_on_noise(draws, rows=300, inputs=3, lags=3, colour=0.0, acceptance="default"):
    """Return in how many draws of white noise as target any term was accepted."""
    generator = torch.Generator().manual_seed(11)
    u = torch.randn(draws, rows, inputs, generator=generator).double()
    for k in range(1, rows):
        u[:, k] = colour * u[:, k - 1] + (1.0 - colour**2) ** 0.5 * u[:, k]
    y = torch.randn(draws, rows, 1, generator=generator).double()
    options = FosOptions(lags=lags, acceptance=acceptance)
    parts = zip(u.split(20), y.split(20), strict=True)
    return sum(
        len(found.model.terms) > 0
        for u, y in parts
        for found in fit_fos_batch(u, y, options=options)
    )


@pytest.mark.parametrize("colour", [0.0, 0.95])
def test_white_noise_has_no_terms(colour):
    assert accepted_on_noise(60, colour=colour) <= 3


@pytest.mark.slow
@pytest.mark.parametrize("colour", [0.0, 0.98])
@pytest.mark.parametrize(
    ("rows", "inputs", "lags"), [(60, 1, 1), (60, 3, 1), (60, 9, 1), (600, 9, 1), (600, 10, 10)]
)
def test_white_noise_has_no_terms_in_many_draws(rows, inputs, lags, colour):
    assert accepted_on_noise(200, rows, inputs, lags, colour) <= 10


@pytest.mark.slow
def test_the_rule_of_the_papers_finds_terms_in_white_noise():
    assert accepted_on_noise(200, 60, 9, 1, acceptance="paper") > 190


def test_finds_ten_true_terms_of_6216():
    generator = torch.Generator().manual_seed(3)
    u = torch.randn(610, 10, generator=generator).double()
    options = FosOptions(lags=10, max_terms=20)
    x = lagged_columns(u, torch.zeros(610).double(), options)
    assert x.shape[0] * (x.shape[0] + 1) // 2 == 6216
    pairs = torch.triu_indices(111, 111)[:, torch.randperm(6216, generator=generator)[:10]].T
    y = torch.zeros(610).double()
    y[10:] = sum(x[i] * x[j] for i, j in pairs.tolist())
    y[10:] += 0.1 * torch.randn(600, generator=generator).double()
    search = Found(u, y, options)
    assert {(i, j) for i, j in pairs.tolist()} == set(search.chosen)
    assert search.outcome.stopped == "no candidate above the level of white noise"
    p, names = matrix(u, y, options)
    chosen, errors, theta = explicit_search(p, names, y[10:].numpy(), np.ones(600), 10)
    assert search.chosen == chosen
    np.testing.assert_allclose(search.errors, errors, rtol=1e-9)
    np.testing.assert_allclose(search.outcome.coefficients, theta, rtol=1e-9)


@pytest.mark.parametrize("ridge", [0.0, 0.02])
def test_exchange_never_loses_and_ends_where_no_swap_helps(ridge):
    options = FosOptions(lags=2, max_terms=5, false_alarm=1.0, exchange_sweeps=20, ridge=ridge)
    swapped = 0
    for seed in range(4):
        u, y = record(rows=60, seed=seed, correlated=0.95)
        search = Found(u, y, options)
        before = search.errors[-1]
        swaps = int(exchange_terms(search.search))
        swapped += swaps
        p, pairs = matrix(u, y, options)
        own = np.sqrt(ridge) * np.linalg.norm(p, axis=0)
        own[0] = 0.0
        full, target = np.vstack([p, np.diag(own)]), np.append(y[2:].numpy(), np.zeros(p.shape[1]))

        def error(chosen, full=full, target=target, pairs=pairs):
            a = full[:, [pairs.index(pair) for pair in chosen]]
            return ((target - a @ np.linalg.lstsq(a, target, rcond=None)[0]) ** 2).sum()

        last = error(search.chosen)
        np.testing.assert_allclose(search.errors[-1], last, rtol=1e-9)
        assert last < before if swaps else last == pytest.approx(before)
        for place in range(5):
            rest = [term for k, term in enumerate(search.chosen) if k != place]
            single = min(error([*rest, pair]) for pair in pairs if pair not in rest)
            assert single >= last * (1.0 - 1e-8)
    assert swapped > 0


@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_nearly_collinear_inputs_do_no_harm(offset):
    for seed in range(8):
        generator = torch.Generator().manual_seed(seed)
        size = 10.0 ** -torch.randint(1, 5, (3,), generator=generator).double()
        y = torch.randn(80, generator=generator).double()
        u = y.roll(3).unsqueeze(1) + size * torch.randn(80, 3, generator=generator).double()
        u[:, 2] = u[:, 1] if seed % 3 == 0 else u[:, 2]
        left = []
        for sweeps in (0, 10):
            options = FosOptions(lags=1, max_terms=10, false_alarm=1.0, exchange_sweeps=sweeps)
            search = Found(u + offset, y, options)
            exchange_terms(search.search)
            outcome = search.outcome
            assert bool(torch.isfinite(outcome.coefficients).all())
            assert outcome.errors[-1] == pytest.approx(outcome.data_error, rel=1e-5)
            left.append(outcome.data_error)
        assert left[1] <= left[0] * (1.0 + 1e-6)


def test_kicks_lead_out_of_where_no_single_swap_gains():
    options = FosOptions(lags=3, max_terms=6, false_alarm=1.0, exchange_sweeps=20, kicks=12)
    gained = 0
    for seed in range(6):
        u, y = record(rows=50, seed=seed, correlated=0.97)
        search = Found(u, y, options)
        exchange_terms(search.search)
        before = search.errors[-1]
        kicks = int(kick_terms(search.search))
        gained += kicks
        p, pairs = matrix(u, y, options)
        a = p[:, [pairs.index(pair) for pair in search.chosen]]
        last = ((y[3:].numpy() - a @ np.linalg.lstsq(a, y[3:].numpy(), rcond=None)[0]) ** 2).sum()
        np.testing.assert_allclose(float(search.search.error), last, rtol=1e-8)
        np.testing.assert_allclose(search.errors[-1], last, rtol=1e-8)
        assert len(set(search.chosen)) == 6
        assert last < before if kicks else last == pytest.approx(before)
    assert gained > 0


def test_backward_drops_what_noise_could_stand_for():
    u, y = record(rows=400)
    greedy = FosOptions(lags=2, max_terms=12, false_alarm=1.0)
    search = Found(u, y, greedy)
    search.search.options = FosOptions(lags=2, max_terms=12, backward=True)
    assert int(search_backward(search.search)) == 8
    assert set(search.chosen) == {(0, 0), (0, 1), (2, 3), (2, 8)}
    p, pairs = matrix(u, y, greedy)
    a = p[:, [pairs.index(pair) for pair in search.chosen]]
    theta = np.linalg.lstsq(a, y[2:].numpy(), rcond=None)[0]
    np.testing.assert_allclose(search.outcome.coefficients, theta, rtol=1e-9)


def test_backward_leaves_nothing_of_white_noise():
    generator = torch.Generator().manual_seed(4)
    u = torch.randn(300, 3, generator=generator).double()
    y = torch.randn(300, generator=generator).double()
    search = Found(u, y, FosOptions(lags=2, max_terms=4, false_alarm=1.0))
    search.search.options = FosOptions(lags=2, max_terms=4)
    assert int(search_backward(search.search)) == 4
    assert search.outcome.coefficients.shape == (0,)
    assert search.errors[-1] == pytest.approx(search.errors[0])


def test_target_error_stops():
    u, y = record()
    search = Found(u, y, FosOptions(lags=2, target_error=0.5))
    assert search.outcome.stopped == "target error reached"
    rms = [(error / 198) ** 0.5 for error in search.errors]
    assert rms[-1] <= 0.5 < rms[-2]


@pytest.mark.parametrize(
    "wrong",
    [
        {"degree": 3},
        {"lags": -1},
        {"max_terms": 0},
        {"false_alarm": 0.0},
        {"ridge": -1.0},
        {"kicks": -1},
        {"acceptance": "p"},
    ],
)
def test_wrong_options(wrong):
    with pytest.raises(ConfigError):
        FosOptions(**wrong)


def test_the_rule_of_the_papers_counts_rows_alone():
    options = FosOptions(acceptance="paper", false_alarm=1e-6)
    assert accepted_share(200.0, 3, 500, options) == pytest.approx(0.02)
    assert accepted_share(3.0, 0, 5, options) == 1.0
    generator = torch.Generator().manual_seed(0)
    u = torch.randn(63, 3, generator=generator).double()
    y = torch.randn(63, 1, generator=generator).double()
    terms = {
        rule: len(fit_fos(u, y, options=FosOptions(lags=3, acceptance=rule)).model.terms)
        for rule in ("default", "paper")
    }
    assert terms["default"] == 0
    assert terms["paper"] >= 4


def test_wrong_shapes():
    with pytest.raises(ShapeError):
        lagged_columns(torch.zeros(5, 2), torch.zeros(6), FosOptions())
    with pytest.raises(ShapeError):
        lagged_columns(torch.zeros(5, 2), torch.zeros(5), FosOptions(lags=5))
