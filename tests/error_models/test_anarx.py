"""ANARX against plain loops over its formula, and against itself in other clothes."""

import math
import subprocess
import sys

import pytest
import torch

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.base import ErrorModel
from navlearn.error_models.scaling import Scaling, fit_scaling
from navlearn.errors import ConfigError, ShapeError


def random_model(seed=0, spread=0.5, **options):
    options = {"inputs": 3, "outputs": 2, "lags": 3, "hidden": 4, **options}
    model = Anarx(AnarxOptions(**options))
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.requires_grad:
                parameter.copy_(spread * torch.randn(parameter.shape, generator=generator).double())
    m, p = options["inputs"], options["outputs"]
    wide = torch.full((m,), 50.0).double()
    model.set_scaling(
        Scaling(torch.arange(m).double(), 1.0 + torch.arange(m).double(), -wide, wide),
        Scaling(0.3 * torch.ones(p).double(), 2.0 * torch.ones(p).double(), -wide[:p], wide[:p]),
    )
    return model


def record(model, windows=4, steps=12, seed=1):
    generator = torch.Generator().manual_seed(seed)
    u = 2.0 * torch.randn(windows, steps, model.inputs, generator=generator).double()
    y = torch.randn(windows, steps, model.outputs, generator=generator).double()
    y_start = torch.randn(windows, model.outputs, generator=generator).double()
    return u, y, y_start


def naive(model, u, y_start, measured=None):
    """Plain loops over y(t+1) = sum_i V_i act(W_i [y(t-i+1), u(t-i+1)] + b_i) + L_i [..] + c."""
    w = {name: value.detach().tolist() for name, value in model.named_parameters()}
    n, p, m = model.memory, model.outputs, model.inputs
    h = len(w["bias"][0])
    mean_u, scale_u = model.u_mean.tolist(), model.u_scale.tolist()
    mean_y, scale_y = model.y_mean.tolist(), model.y_scale.tolist()
    rows = []
    for t in range(len(u)):
        total = list(w["offset"])
        for i in range(1, n + 1):
            at = t - i
            past = rows if measured is None else measured
            fed = y_start if at < 0 else past[at]
            given = u[max(t - i + 1, 0)]
            z = [(fed[j] - mean_y[j]) / scale_y[j] for j in range(p)]
            z += [(given[j] - mean_u[j]) / scale_u[j] for j in range(m)]
            for k in range(h):
                pre = w["bias"][i - 1][k]
                pre += sum(w["weight"][i - 1][k][c] * z[c] for c in range(p + m))
                active = 1.0 / (1.0 + math.exp(-pre)) if model.sigmoid else math.tanh(pre)
                for j in range(p):
                    total[j] += w["out"][i - 1][j][k] * active
            for j in range(p):
                total[j] += sum(w["linear"][i - 1][j][c] * z[c] for c in range(p + m))
        rows.append([mean_y[j] + scale_y[j] * total[j] for j in range(p)])
    return rows


VARIANTS = [
    {"activation": "sigmoid", "linear_path": False},
    {"activation": "tanh", "linear_path": True},
    {"lags": 1, "hidden": 1, "outputs": 1},
]


@pytest.mark.parametrize("variant", VARIANTS)
def test_closed_loop_equals_plain_loops(variant):
    model = random_model(spread=0.2, safeguard=False, **variant)
    u, _, y_start = record(model)
    run = model(u, y_start)
    for k in range(u.shape[0]):
        exact = naive(model, u[k].tolist(), y_start[k].tolist())
        torch.testing.assert_close(
            run[k], torch.tensor(exact, dtype=torch.float64), rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("variant", VARIANTS)
def test_open_loop_equals_plain_loops(variant):
    model = random_model(safeguard=False, **variant)
    u, y, y_start = record(model)
    ahead = model.open_loop(u, y, y_start)
    exact = naive(model, u[1].tolist(), y_start[1].tolist(), y[1].tolist())
    torch.testing.assert_close(
        ahead[1], torch.tensor(exact, dtype=torch.float64), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("safeguard", [True, False])
def test_step_over_a_record_equals_forward(variant, safeguard):
    model = random_model(safeguard=safeguard, output_limit=0.8, **variant)
    u, _, y_start = record(model)
    state = model.initial_state(u[:, 0], y_start)
    rows = []
    for t in range(u.shape[1]):
        y, state = model.step(u[:, t], state)
        rows.append(y)
    run, last = model.run(u, model.initial_state(u[:, 0], y_start))
    torch.testing.assert_close(torch.stack(rows, 1), run, rtol=0, atol=1e-13)
    torch.testing.assert_close(state, last, rtol=0, atol=1e-13)
    assert torch.equal(model(u, y_start), run)


def test_a_run_can_be_cut_anywhere():
    model = random_model()
    u, _, y_start = record(model)
    start = model.initial_state(u[:, 0], y_start)
    first, middle = model.run(u[:, :5], start)
    second, _ = model.run(u[:, 5:], middle)
    whole = model(u, y_start)
    torch.testing.assert_close(torch.cat([first, second], 1), whole, rtol=0, atol=1e-13)
    none, same = model.run(u[:, :0], start)
    assert none.shape == (4, 0, 2)
    assert torch.equal(same, start)


def test_fed_with_its_own_output_open_loop_is_closed_loop():
    model = random_model(safeguard=False)
    u, _, y_start = record(model)
    own = model(u, y_start)
    torch.testing.assert_close(model.open_loop(u, own, y_start), own, rtol=0, atol=1e-12)


@pytest.mark.parametrize("rows", [1, 2, 3, 7])
def test_warm_state_goes_on_where_measured_outputs_end(rows):
    model = random_model(safeguard=False)
    u, _, y_start = record(model)
    own = model(u, y_start)
    state = model.warm_state(u[:, :rows], own[:, :rows], y_start)
    rest, _ = model.run(u[:, rows:], state)
    torch.testing.assert_close(rest, own[:, rows:], rtol=0, atol=1e-12)


def test_leading_shapes_are_free():
    model = random_model()
    u, y, y_start = record(model, windows=6)
    cube = model(u.reshape(2, 3, 12, 3), y_start.reshape(2, 3, 2))
    torch.testing.assert_close(cube.reshape(6, 12, 2), model(u, y_start), rtol=0, atol=1e-13)
    single = model(u[0], y_start[0])
    torch.testing.assert_close(single, model(u, y_start)[0], rtol=0, atol=1e-13)
    assert model.open_loop(u[0], y[0]).shape == (12, 2)


def test_scripted_equals_eager():
    model = random_model(output_limit=0.9)
    scripted = torch.jit.script(model)
    u, y, y_start = record(model)
    torch.testing.assert_close(scripted(u, y_start), model(u, y_start), rtol=0, atol=1e-12)
    torch.testing.assert_close(scripted(u), model(u), rtol=0, atol=1e-12)
    torch.testing.assert_close(
        scripted.open_loop(u, y, y_start), model.open_loop(u, y, y_start), rtol=0, atol=1e-12
    )
    state, other = model.initial_state(u[:, 0]), scripted.initial_state(u[:, 0])
    for t in range(u.shape[1]):
        a, state = model.step(u[:, t], state)
        b, other = scripted.step(u[:, t], other)
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12)
    assert scripted.memory == 3
    assert torch.equal(scripted.count_clamped(100.0 * u), model.count_clamped(100.0 * u))
    assert torch.equal(scripted.count_limited(model(u)), model.count_limited(model(u)))


def test_scripted_model_reloads_in_a_fresh_process(tmp_path):
    model = random_model()
    u, _, y_start = record(model)
    torch.jit.script(model).save(tmp_path / "model.pt")
    torch.save({"u": u, "y_start": y_start}, tmp_path / "in.pt")
    program = (
        "import sys, torch\n"
        "given = torch.load(sys.argv[1] + '/in.pt', weights_only=True)\n"
        "model = torch.jit.load(sys.argv[1] + '/model.pt')\n"
        "torch.save(model(given['u'], given['y_start']).detach(), sys.argv[1] + '/out.pt')\n"
        "assert 'navlearn' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=True)
    found = torch.load(tmp_path / "out.pt", weights_only=True)
    torch.testing.assert_close(found, model(u, y_start), rtol=0, atol=1e-12)


def test_inputs_are_clamped_to_the_training_range_and_counted():
    model = random_model(inputs=1, outputs=1, lags=1)
    u = torch.tensor([[-60.0], [0.0], [80.0], [torch.nan]], dtype=torch.float64)
    held = torch.tensor([[-50.0], [0.0], [50.0], [0.0]], dtype=torch.float64)
    assert torch.equal(model(u), model(held))
    assert model.count_clamped(u).tolist() == [1, 0, 1, 1]
    raw = random_model(inputs=1, outputs=1, lags=1, safeguard=False)
    assert not torch.equal(raw(u[:3]), raw(held[:3]))
    assert not bool(torch.isfinite(raw(u)).all())


def runaway(**options):
    """A network that doubles its output at every step."""
    model = random_model(inputs=1, outputs=1, lags=2, **options)
    with torch.no_grad():
        model.linear.zero_()
        model.linear[0, 0, 0] = 2.0
        u = torch.zeros(1, 200, 1).double()
        return model, model(u, torch.ones(1, 1).double())


def test_outputs_are_limited_and_counted():
    model, y = runaway(output_limit=1.5)
    assert float((y - 0.3).abs().max()) <= 1.5 * 2.0 + 1e-12
    assert abs(abs(float(y[0, -1]) - 0.3) - 1.5 * 2.0) < 1e-12
    assert int(model.count_limited(y).sum()) > 100
    unguarded, free = runaway(safeguard=False)
    assert float(free.abs().max()) > 1e20
    assert int(unguarded.count_limited(y).sum()) == 0


def test_closed_loop_gradients_are_right():
    model = random_model(inputs=2, outputs=1, lags=2, hidden=2)
    u, _, y_start = record(model, windows=2, steps=4)
    assert torch.autograd.gradcheck(lambda a, b: model(a, b), (u.requires_grad_(), y_start))


def test_prediction_variance_is_held_beyond_the_longest_window():
    model = random_model(outputs=1)
    assert math.isinf(float(model.prediction_variance(3)))
    model.set_variance(torch.tensor([[1.0], [2.0], [4.0]], dtype=torch.float64))
    assert [float(model.prediction_variance(k)) for k in (0, 1, 2, 3, 99)] == [1, 1, 2, 4, 4]
    with pytest.raises(ShapeError, match=r"expected \(H, 1\)"):
        model.set_variance(torch.zeros(3).double())


def test_keeps_the_contract_of_error_models():
    assert isinstance(random_model(), ErrorModel)
    assert not isinstance(torch.nn.Linear(2, 2), ErrorModel)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"lags": 0}, "lags is 0"),
        ({"activation": "relu"}, "choose sigmoid or tanh"),
        ({"output_limit": 0.0}, "output_limit is 0.0"),
    ],
)
def test_options_refuse(wrong, said):
    with pytest.raises(ConfigError, match=said):
        AnarxOptions(**{"inputs": 1, **wrong})


def test_scaling_is_part_of_the_model():
    plain, scaled = random_model(safeguard=False), random_model(safeguard=False)
    u, y, _ = record(plain)
    weight = torch.ones(u.shape[:2]).double()
    scaled.set_scaling(fit_scaling(u, weight), fit_scaling(y, weight))
    standard = scaled.standardise_inputs(u).reshape(-1, 3)
    assert float(standard.mean(0).abs().max()) < 1e-12
    assert float((standard.std(0, correction=0) - 1.0).abs().max()) < 1e-12
    assert not torch.allclose(plain(u), scaled(u))
