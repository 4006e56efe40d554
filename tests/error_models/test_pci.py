"""PCI against plain loops and against systems that are known."""

import itertools
import re

import pytest
import torch

from navlearn.error_models.base import ErrorModel
from navlearn.error_models.pci import PciModel, PciOptions
from navlearn.error_models.pci_candidates import (
    Draw,
    draw_candidates,
    fit_cascades,
    linear_responses,
)
from navlearn.error_models.pci_fit import fit_pci, fit_pci_windows
from navlearn.error_models.pci_polish import polish
from navlearn.error_models.volterra import volterra_kernels
from navlearn.errors import ConfigError, FitError, ShapeError

FIRST = torch.tensor([[1.0, 0.6, 0.2, -0.3]]).double()
SECOND = torch.tensor([[0.3, -0.5, 0.8, 0.1]]).double()
POWERS = ((0.5, 1.0, -0.3, 0.05), (0.0, 0.0, 0.4, -0.1))


def noise(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


def filtered(x, response):
    """Convolution by plain sums, inputs held before the start; response (m, R + 1)."""
    total = torch.zeros(len(x)).double()
    for i, j in itertools.product(range(response.shape[0]), range(response.shape[1])):
        total += response[i, j] * torch.cat((x[:1, i].expand(j), x[: len(x) - j, i]))
    return total


def shares(windows, rows, seed):
    share = torch.rand(windows, rows, generator=torch.Generator().manual_seed(seed)).double()
    return share / share.sum(-1, keepdim=True)


def two_cascades(x, responses):
    outputs = [filtered(x, g) for g in responses]
    return sum(p * u**d for u, row in zip(outputs, POWERS, strict=True) for d, p in enumerate(row))


def single(rows=1500, seed=1):
    x = 1.5 + 2.0 * noise(rows, 1, seed=seed)
    return x, two_cascades(x, (FIRST, SECOND))


def double(rows=2500, seed=2):
    x = noise(rows, 2, seed=seed) * torch.tensor([1.0, 3.0]).double() + 0.4
    responses = (torch.cat((FIRST, 0.2 * SECOND)), torch.cat((-0.4 * FIRST, 0.3 * SECOND)))
    return x, two_cascades(x, responses), responses


def kernels_of(responses):
    """Kernels of the generating system, by their definition, channels inside lags."""
    flat = [g.T.reshape(-1) for g in responses]
    zeroth = sum(row[0] for row in POWERS)
    first = sum(row[1] * g for row, g in zip(POWERS, flat, strict=True))
    second = sum(row[2] * torch.outer(g, g) for row, g in zip(POWERS, flat, strict=True))
    third = sum(
        row[3] * g[:, None, None] * g[:, None] * g for row, g in zip(POWERS, flat, strict=True)
    )
    return zeroth, first, second, third


def test_correlations_equal_plain_loops():
    lagged, residual, share = noise(2, 40, 6), noise(2, 40, seed=1), shares(2, 40, 2)
    reads = torch.tensor([[True] * 6, [True, False] * 3, [True] * 6])
    draw = Draw(
        torch.tensor([1, 2, 3]),
        torch.tensor([[4, 1], [3, 0], [2, 2]]),
        torch.tensor([[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]]).double(),
        reads,
    )
    root, size = share.sqrt(), torch.tensor([0.7, 0.2]).double()
    found = linear_responses(lagged, root * residual, root, size, draw)
    for b, m, j in itertools.product(range(2), range(3), range(6)):
        value = 0.0
        for n in range(40):
            term = float(share[b, n] * residual[b, n] * lagged[b, n, j])
            for k in range(int(draw.order[m]) - 1):
                term *= float(lagged[b, n, draw.slices[m, k]])
            value += term * float(reads[m, j])
        for k in range(int(draw.order[m]) - 1):
            value += float(size[b] * draw.signs[m, k]) * (j == int(draw.slices[m, k]))
        assert float(found[b, m, j]) == pytest.approx(value, abs=1e-14)


def test_one_cascade_equals_least_squares_on_powers():
    lagged, residual, response = noise(2, 200, 5), noise(2, 200, seed=1), noise(2, 3, 5, seed=2)
    share = shares(2, 200, 3)
    fitted, power = fit_cascades(lagged, share.sqrt() * residual, share.sqrt(), response, 3)
    for b, k in itertools.product(range(2), range(3)):
        u = lagged[b] @ fitted.response[b, k]
        assert float((share[b] * u * u).sum()) == pytest.approx(1.0, abs=1e-12)
        vandermonde = torch.stack([u**d for d in range(4)], -1)
        weighted = vandermonde.T * share[b]
        z = vandermonde @ torch.linalg.solve(weighted @ vandermonde, weighted @ residual[b])
        assert float(power[b, k]) == pytest.approx(float((share[b] * z * z).sum()), rel=1e-10)


def test_a_linear_output_without_power_explains_nothing():
    root = torch.full((1, 30), 1.0 / 30).double().sqrt()
    fitted, power = fit_cascades(
        noise(1, 30, 4), root * noise(1, 30), root, torch.zeros(1, 1, 4).double(), 3
    )
    assert float(power) == 0.0
    assert all(bool(torch.isfinite(field).all()) for field in fitted[:4])


def test_draws_reach_every_order_and_lag_and_repeat_with_the_seed():
    first = draw_candidates(500, 3, 4, 2, torch.Generator().manual_seed(5))
    again = draw_candidates(500, 3, 4, 2, torch.Generator().manual_seed(5))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert set(first.order.tolist()) == {1, 2, 3}
    assert set(first.slices.reshape(-1).tolist()) == set(range(10))
    assert set(first.reads.sum(-1).tolist()) == {5, 10}
    assert int(first.order[0]) == 1
    assert bool(first.reads[0].all())
    generator = torch.Generator().manual_seed(5)
    single = [draw_candidates(1, 3, 4, 2, generator) for _ in range(100)]
    assert {int(draw.order) for draw in single} == {1, 2, 3}
    assert {int(draw.reads.sum()) for draw in single} == {5, 10}


@pytest.mark.parametrize(("refit", "polish"), [(True, 10), (True, 0), (False, 0)])
def test_recovers_two_cascades_and_their_kernels(refit, polish):
    x, y = single()
    options = PciOptions(lags=3, refit=refit, polish=polish, cascades=60, safeguard=False)
    fitted = fit_pci(x[:1000], y[:1000], options)
    model = fitted.model
    assert fitted.cascades == 2 or not polish
    held_out = ((model(x)[1000:, 0] - y[1000:]) ** 2).mean() / y.var()
    assert float(held_out) < (1e-20 if refit else 1e-5)
    tolerance = 1e-9 if refit else 5e-3
    for found, known in zip(volterra_kernels(model), kernels_of((FIRST, SECOND)), strict=True):
        known = torch.as_tensor(known, dtype=torch.float64).reshape(found.shape)
        torch.testing.assert_close(found, known, rtol=0, atol=tolerance)


def test_recovers_two_cascades_of_two_inputs_and_their_kernels():
    x, y, responses = double()
    options = PciOptions(
        inputs=2, lags=3, cascades=150, acceptance="paper", safeguard=False, tried=40_000
    )
    fitted = fit_pci(x[:1500], y[:1500], options)
    assert fitted.record.stopped == "target"
    assert float(((fitted.model(x)[1500:, 0] - y[1500:]) ** 2).mean() / y.var()) < 1e-10
    for found, known in zip(volterra_kernels(fitted.model), kernels_of(responses), strict=True):
        known = torch.as_tensor(known, dtype=torch.float64).reshape(found.shape)
        torch.testing.assert_close(found, known, rtol=0, atol=1e-5)


@pytest.mark.parametrize("degree", [1, 2, 5])
def test_kernels_of_every_degree_equal_derivatives_at_zero(degree):
    x, y, _ = double(300)
    y = y + noise(300, seed=7)
    options = PciOptions(inputs=2, lags=2, degree=degree, cascades=3, safeguard=False)
    model = fit_pci(x, y, options).model
    found = volterra_kernels(model)
    zero = torch.zeros(1, 3, 2).double()

    def output(flat):
        return model.respond((flat.reshape(1, 3, 2) - model.u_mean) / model.u_scale).sum()

    gradient = torch.autograd.functional.jacobian(output, zero.reshape(-1))
    hessian = torch.autograd.functional.hessian(output, zero.reshape(-1))
    by_lag = found.first.flip(0).reshape(-1)
    torch.testing.assert_close(
        float(found.zeroth),
        float(model.respond(zero * 0 - (model.u_mean / model.u_scale))),
        rtol=1e-9,
        atol=1e-9,
    )
    torch.testing.assert_close(by_lag, gradient, rtol=1e-8, atol=1e-8)
    second = found.second.flip(0).flip(2).reshape(6, 6)
    torch.testing.assert_close(2.0 * second, hessian, rtol=1e-8, atol=1e-8)
    assert degree > 2 or not bool(found.third.any())


def read_sum(line, values):
    """Return the value of a written sum, given what its factors stand for."""
    total = 0.0
    for sign, number, factor in re.findall(
        r"([+-])(\d[\d.e+-]*)(?: [^·\s+-]\S*)?(?: · (\S+))?", line.partition(" = ")[2]
    ):
        total += float(sign + number) * (values[factor] if factor else 1.0)
    return total


@pytest.mark.parametrize("units", [(), ("m/s", "rad/s")])
def test_the_written_equations_say_what_the_model_does(units):
    x, y, _ = double(600)
    options = PciOptions(inputs=2, lags=2, cascades=2, safeguard=False)
    model = fit_pci(x, y + noise(600), options).model
    lines = model.equation(("speed", "rate"), "error", units, "m" if units else "").splitlines()
    assert len(lines) == 1 + 3 * len(model.response)
    if units:
        assert " m · v1[k]³" in lines[1]
        assert " s/m · speed[k-1]" in lines[2]
        assert " s/rad · rate[k]" in lines[2]
    window = {
        f"{name}[k-{lag}]".replace("[k-0]", "[k]"): float(x[99 - lag, i])
        for i, name in enumerate(("speed", "rate"))
        for lag in range(3)
    }
    total = read_sum(lines[0].partition(" + w1")[0], {})
    for c in (1, 2):
        v = read_sum(lines[3 * c - 1], window)
        low, high = (float(bound) for bound in lines[3 * c].split(f" <= v{c}[k] <= "))
        assert low * 1.01 <= v <= high * 1.01
        total += read_sum(lines[3 * c - 2], {f"v{c}[k]": v, f"v{c}[k]²": v**2, f"v{c}[k]³": v**3})
    assert total == pytest.approx(float(model(x)[99, 0]), rel=1e-3)


def test_without_cascades_the_equation_is_the_mean():
    model = fit_pci(noise(600, 1), 3.0 + noise(600, seed=1), PciOptions()).model
    assert model.equation() == f"y[k] = {float(model.y_mean):+.6g}"
    with pytest.raises(ConfigError, match="2 names"):
        model.equation(("one", "two"))


STOPS = [
    ({"cascades": 2}, "cascades"),
    ({"tried": 100}, "tried"),
    ({"target": 0.5}, "target"),
    ({"degree": 1, "order": 1}, "none passed"),
]


@pytest.mark.parametrize(("changed", "stopped"), STOPS)
def test_each_rule_stops(changed, stopped):
    x, y = single(600)
    fitted = fit_pci(x, y + noise(600, seed=9), PciOptions(lags=3, **changed))
    assert fitted.record.stopped == stopped
    assert fitted.tried <= changed.get("tried", 10_000)
    assert len(fitted.curves.train) == fitted.cascades + 1
    assert list(fitted.curves.train) == sorted(fitted.curves.train, reverse=True)


@pytest.mark.parametrize("safeguard", [True, False])
@pytest.mark.parametrize("lags", [0, 3])
def test_step_equals_forward_and_scripts(safeguard, lags):
    x, y, _ = double(400)
    options = PciOptions(inputs=2, lags=lags, safeguard=safeguard, cascades=5)
    model = fit_pci(x, y + noise(400), options).model
    assert isinstance(model, ErrorModel)
    scripted = torch.jit.script(model)
    u = 2.0 * noise(3, 20, 2, seed=8)
    whole = model(u)
    for runner in (model, scripted):
        state = runner.initial_state(u[:, 0])
        rows = []
        for t in range(20):
            row, state = runner.step(u[:, t], state)
            rows.append(row)
        torch.testing.assert_close(torch.stack(rows, 1), whole, rtol=0, atol=1e-11)
    torch.testing.assert_close(scripted(u), whole, rtol=0, atol=1e-12)
    assert torch.equal(scripted.prediction_variance(7), model.prediction_variance(1))
    assert whole.shape == (3, 20, 1)
    assert model(u[:, :0]).shape == (3, 0, 1)


def test_the_safeguard_bounds_what_leaves_the_training_range():
    x, y = single(600)
    model = fit_pci(x, y, PciOptions(lags=3)).model
    far = torch.full((5, 1), 1e6).double()
    assert torch.equal(model(far), model(torch.full_like(far, float(x.max()))))
    reach = model.limit * model.y_scale * (1 + 1e-12)
    assert bool(((model(100.0 * x) - model.y_mean).abs() <= reach).all())
    assert model.count_clamped(far).tolist() == [1] * 5
    wild = fit_pci(x, y, PciOptions(lags=3, safeguard=False)).model
    assert float(wild(far).abs().max()) > 1e6


def test_without_cascades_the_mean_is_all():
    fitted = fit_pci(noise(600, 1), 3.0 + noise(600, seed=1), PciOptions())
    assert fitted.cascades == 0
    assert torch.equal(fitted.model(noise(4, 1)), fitted.model.y_mean.expand(4, 1))
    assert float(fitted.model.prediction_variance(1)) == pytest.approx(1.0, abs=0.2)
    assert torch.isinf(PciModel(PciOptions()).prediction_variance(1)).all()


def test_the_variance_is_that_of_the_noise():
    x, y = single(4000)
    fitted = fit_pci(x, y + 0.5 * noise(4000, seed=5), PciOptions(lags=3))
    assert float(fitted.model.prediction_variance(1)) == pytest.approx(0.25, rel=0.1)


def test_the_same_seed_gives_the_same_model_whatever_the_global_one():
    x, y = single(500)
    y = y + noise(500)
    torch.manual_seed(1)
    first = fit_pci(x, y, PciOptions(lags=3, seed=4, refit=False, polish=0)).model.state_dict()
    torch.manual_seed(2)
    again = fit_pci(x, y, PciOptions(lags=3, seed=4, refit=False, polish=0)).model.state_dict()
    other = fit_pci(x, y, PciOptions(lags=3, seed=5, refit=False, polish=0)).model.state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["weight"], other["weight"])


def test_rows_of_weight_zero_and_their_shadows_are_not_read():
    x, y = single(600)
    y = y + noise(600)
    weight = torch.ones(600).double()
    weight[250:260] = 0.0
    spoilt_x, spoilt_y = x.clone(), y.clone()
    spoilt_x[250:260], spoilt_y[250:260] = torch.nan, torch.nan
    fitted = fit_pci(spoilt_x, spoilt_y, PciOptions(lags=3), weight)
    assert fitted.record.samples == 600 - 3 - 10 - 3
    halves = [torch.stack((z[:250], z[350:])) for z in (x, y)]
    windows = fit_pci(*halves, PciOptions(lags=3))
    assert windows.record.samples == 2 * (250 - 3)
    assert bool(torch.isfinite(fitted.model(x)).all())


def test_doubling_all_weights_changes_nothing():
    x, y = single(500)
    weight = torch.rand(500, generator=torch.Generator().manual_seed(1)).double()
    once = fit_pci(x, y, PciOptions(lags=3, cascades=4), weight)
    twice = fit_pci(x, y, PciOptions(lags=3, cascades=4), 2.0 * weight)
    torch.testing.assert_close(once.model(x), twice.model(x))


@pytest.mark.parametrize(
    "options",
    [
        {"cascades": 5},
        {"cascades": 5, "polish": 0},
        {"cascades": 5, "polish": 0, "refit": False},
        {"acceptance": "paper", "target": 0.5},
        {"cascades": 4, "batch": 3, "misses": 3},
    ],
)
def test_windows_at_once_equal_one_by_one(options):
    options = PciOptions(inputs=2, lags=2, **options)
    x, y, _ = double(5 * 150)
    x, y = x.reshape(5, 150, 2), y.reshape(5, 150) * torch.arange(5).double().unsqueeze(-1)
    y = y + noise(5, 150, seed=6)
    weight = torch.rand(5, 150, generator=torch.Generator().manual_seed(4)).double()
    weight[1, 40:50], weight[3, :20] = 0.0, 0.0
    spoilt = torch.where(weight > 0, y, torch.nan)
    together = fit_pci_windows(x, spoilt.unsqueeze(-1), options, weight)
    assert len({fitted.cascades for fitted in together}) > 1
    for k, fitted in enumerate(together):
        alone = fit_pci(x[k], spoilt[k], options, weight[k])
        assert (fitted.tried, fitted.cascades) == (alone.tried, alone.cascades)
        assert fitted.record.samples == alone.record.samples
        assert fitted.record.stopped == alone.record.stopped
        assert list(fitted.curves.train) == pytest.approx(list(alone.curves.train), rel=1e-7)
        # Polishing walks along valleys that are nearly flat, which enlarges rounding.
        near = 1e-5 if options.polish else 1e-8
        torch.testing.assert_close(fitted.model(x[k]), alone.model(x[k]), rtol=near, atol=near)
        variance = fitted.model.prediction_variance(1)
        torch.testing.assert_close(variance, alone.model.prediction_variance(1), rtol=1e-6, atol=0)


def test_a_polishing_step_is_that_of_the_explicit_gauss_newton():
    """With all polynomials fitted again, as the derivative of the residual by the responses."""
    lagged, root = noise(1, 80, 4), torch.full((1, 80), 1.0 / 80, dtype=torch.float64).sqrt()
    u = lagged[0] @ torch.tensor([1.0, 0.5, 0.2, 0.0]).double()
    target = root * (u + 0.5 * u**2 + 0.01 * noise(80, seed=1))

    def left(flat):
        values = lagged[0] @ flat.reshape(1, 4).T
        columns = root.mT * torch.cat((values**0, values, values**2), 1)
        return target[0] - columns @ torch.linalg.lstsq(columns, target.mT).solution[:, 0]

    start = torch.tensor([[[1.0, 0.45, 0.25, 0.02]]]).double()
    for _ in range(12):
        jacobian = torch.autograd.functional.jacobian(left, start.reshape(-1))
        step = torch.linalg.lstsq(jacobian, -left(start.reshape(-1)).unsqueeze(-1), driver="gelsd")
        start = start + step.solution.reshape(1, 1, 4)
    begin = torch.tensor([[[1.0, 0.45, 0.25, 0.02]]]).double()
    response, residual = polish(lagged, target, root, begin, 2, 200)
    cosine = torch.cosine_similarity(response.reshape(-1), start.reshape(-1), dim=0)
    assert abs(float(cosine)) == pytest.approx(1.0, abs=1e-6)
    found, known = float(residual.square().sum()), float(left(start.reshape(-1)).square().sum())
    assert found == pytest.approx(known, rel=1e-3)


def test_polishing_keeps_taps_of_zero_and_rows_without_cascade():
    x, y, _ = double(400)
    lagged = x.unfold(0, 3, 1).flip(-1).transpose(-1, -2).reshape(1, -1, 6)
    root = torch.full((1, 398), 1.0 / 398, dtype=torch.float64).sqrt()
    target = root * ((y - y.mean()) / y.std())[2:]
    response = noise(1, 3, 6, seed=3)
    response[0, 0, ::2], response[0, 2] = 0.0, 0.0
    before, _ = polish(lagged, target, root, response, 3, 0)
    after, residual = polish(lagged, target, root, response, 3, 10)
    _, start = polish(lagged, target, root, response, 3, 0)
    assert torch.equal(after == 0.0, response == 0.0)
    assert float(residual.square().sum()) < 0.9 * float(start.square().sum())
    power = ((lagged @ after.mT)[..., :2] * root.unsqueeze(-1)).square().sum(1)
    torch.testing.assert_close(power, torch.ones_like(power))
    torch.testing.assert_close(before[0, 1] / before[0, 1, 0], response[0, 1] / response[0, 1, 0])


def test_polishing_finds_a_system_that_noise_hides_from_correlations():
    counts, held = [], []
    for polished in (0, 10):
        x, y, _ = double(2600)
        noisy = y + 0.2 * y.std() * noise(2600, seed=5)
        fitted = fit_pci(x[:600], noisy[:600], PciOptions(inputs=2, lags=3, polish=polished))
        error = (fitted.model(x)[600:, 0] - y[600:]).square().mean() / y.var()
        counts.append(fitted.cascades)
        held.append(float(error))
    assert counts[1] == 2 <= counts[0]
    assert held[1] < 0.5 * held[0]


def test_windows_are_asked_for_as_windows():
    x, y = single(100)
    assert fit_pci_windows(x[None][:0], y[None][:0], PciOptions()) == []
    with pytest.raises(ShapeError, match=r"windows \(B, T, 1\)"):
        fit_pci_windows(x, y, PciOptions())


def test_each_batch_without_any_that_passes_is_a_miss():
    x, y = noise(600, 1), noise(600, seed=1)
    fitted = fit_pci(x, y, PciOptions(misses=4, batch=8))
    assert (fitted.cascades, fitted.tried, fitted.record.stopped) == (0, 32, "none passed")


def test_the_paper_is_one_call_away():
    options = PciOptions.paper(lags=4)
    assert (options.acceptance, options.batch, options.lags) == ("paper", 1, 4)
    assert not options.refit
    assert not options.safeguard


def test_bad_data_are_refused_by_name():
    x, y = single(100)
    spoilt = x.clone()
    spoilt[7] = torch.nan
    with pytest.raises(FitError, match="not finite"):
        fit_pci(spoilt, y, PciOptions())
    with pytest.raises(FitError, match="too short"):
        fit_pci(x[:5], y[:5], PciOptions())
    with pytest.raises(FitError, match="negative"):
        fit_pci(x, y, PciOptions(), -torch.ones(100))
    with pytest.raises(FitError, match="positive weight before"):
        fit_pci(x, y, PciOptions(), torch.arange(100) % 2)
    with pytest.raises(ShapeError, match="expected"):
        fit_pci(x, y[:50], PciOptions())
    with pytest.raises(ShapeError, match="expected"):
        fit_pci(x, y, PciOptions(inputs=2))


@pytest.mark.parametrize(
    "wrong",
    [
        {"inputs": 0},
        {"lags": -1},
        {"order": 4},
        {"acceptance": "other"},
        {"level": 1.0},
        {"target": -1.0},
        {"misses": 0},
        {"polish": -1},
        {"polish": 3, "refit": False},
        {"output_limit": 0.0},
    ],
)
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        PciOptions(**wrong)
