"""Analytic Jacobians against automatic differentiation."""

import pytest
import torch
from torch.func import jacrev

from navlearn.error_models.anarx_core import (
    AnarxWeights,
    free_run,
    held_rows,
    held_state,
    lag_outputs,
    one_step_ahead,
)
from navlearn.error_models.anarx_jacobian import (
    closed_loop_jacobian,
    feedback_jacobian,
    one_step_jacobian,
    pack_weights,
    unpack_weights,
)

SHAPES = [(1, 2, 1, 1), (3, 4, 2, 3), (2, 1, 3, 2)]


def random_weights(n, h, p, m, linear_path, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return 0.4 * torch.randn(*shape, generator=generator, dtype=torch.float64)

    linear = draw(n, p, p + m) if linear_path else torch.zeros(n, p, p + m).double()
    return AnarxWeights(draw(n, h, p + m), draw(n, h), draw(n, p, h), linear, draw(p))


def random_record(p, m, seed=1):
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(3, 7, m, generator=generator, dtype=torch.float64)
    y = torch.randn(3, 7, p, generator=generator, dtype=torch.float64)
    return u, y, torch.randn(3, p, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("linear_path", [True, False])
@pytest.mark.parametrize("sigmoid", [True, False])
def test_one_step_jacobian(shape, linear_path, sigmoid):
    n, _, p, m = shape
    w = random_weights(*shape, linear_path)
    before, u = held_rows(*random_record(p, m), n)
    theta = pack_weights(w, linear_path)

    def predict(theta):
        return one_step_ahead(unpack_weights(theta, w, linear_path), sigmoid, before, u)

    analytic = one_step_jacobian(w, sigmoid, linear_path, before, u)
    torch.testing.assert_close(analytic, jacrev(predict)(theta), rtol=0, atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("linear_path", [True, False])
@pytest.mark.parametrize("sigmoid", [True, False])
def test_closed_loop_jacobian_with_the_start_held(shape, linear_path, sigmoid):
    n, _, p, m = shape
    w = random_weights(*shape, linear_path)
    u, y, y_start = random_record(p, m)
    theta = pack_weights(w, linear_path)

    def run(theta):
        trial = unpack_weights(theta, w, linear_path)
        return free_run(
            trial, sigmoid, float("inf"), u, held_state(trial, sigmoid, y_start, u[:, 0])
        )[0]

    before, rows = held_rows(u, y, y_start, n)
    before = torch.cat([before[:, :n], run(theta)[:, :-1]], 1)
    analytic = closed_loop_jacobian(w, sigmoid, linear_path, before, rows)
    torch.testing.assert_close(analytic, jacrev(run)(theta), rtol=1e-10, atol=1e-12)


def test_feedback_jacobian():
    w = random_weights(3, 4, 2, 3, True)
    u, y, _ = random_record(2, 3)
    analytic = feedback_jacobian(w, False, y, u)
    automatic = torch.func.vmap(torch.func.vmap(jacrev(lambda a, b: lag_outputs(w, False, a, b))))(
        y, u
    )
    torch.testing.assert_close(analytic, automatic, rtol=0, atol=1e-13)


@pytest.mark.parametrize("linear_path", [True, False])
def test_packing_is_undone_by_unpacking(linear_path):
    w = random_weights(3, 4, 2, 3, linear_path)
    theta = pack_weights(w, linear_path)
    assert theta.shape == (3 * (4 * 5 + 4 + 2 * 4 + (2 * 5 if linear_path else 0)) + 2,)
    for found, expected in zip(unpack_weights(theta, w, linear_path), w, strict=True):
        assert torch.equal(found, expected)
