"""Levenberg–Marquardt on problems with known answers, and against SciPy."""

import itertools

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares
from torch.func import jacrev

from navlearn.errors import ConfigError, FitError
from navlearn.learning.levenberg_marquardt import (
    LmOptions,
    NormalEquations,
    levenberg_marquardt,
    start_state,
)


class Problem:
    """Residuals given as a function; the Jacobian by automatic differentiation."""

    def __init__(self, function):
        self.function = function
        self.linearised = 0

    def cost(self, theta):
        r = self.function(theta)
        return 0.5 * float(r @ r)

    def normal_equations(self, theta):
        self.linearised += 1
        r, jacobian = self.function(theta), jacrev(self.function)(theta)
        return NormalEquations(self.cost(theta), jacobian.T @ jacobian, jacobian.T @ r)


def rosenbrock(theta):
    return torch.stack([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]])


def test_finds_the_minimum_of_rosenbrock():
    start = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    state = levenberg_marquardt(Problem(rosenbrock), start, LmOptions(max_iterations=200))
    torch.testing.assert_close(state.theta, torch.ones(2).double(), rtol=0, atol=1e-8)
    assert state.stopped in ("gradient", "step", "cost", "damping")
    assert start.tolist() == [-1.2, 1.0]


def test_ridge_gives_the_closed_form_on_a_linear_problem():
    generator = torch.Generator().manual_seed(0)
    a = torch.randn(30, 4, generator=generator).double()
    b = torch.randn(30, generator=generator).double()
    state = levenberg_marquardt(
        Problem(lambda theta: a @ theta - b), torch.zeros(4).double(), LmOptions(ridge=2.5)
    )
    exact = torch.linalg.solve(a.T @ a + 2.5 * torch.eye(4).double(), a.T @ b)
    torch.testing.assert_close(state.theta, exact, rtol=0, atol=1e-8)


def test_same_minimum_as_scipy_on_an_exponential_fit():
    t = torch.linspace(0, 4, 60, dtype=torch.float64)
    noise = 0.05 * torch.randn(60, generator=torch.Generator().manual_seed(1)).double()
    data = 2.0 * torch.exp(-0.8 * t) + 0.5 + noise

    def residual(theta):
        return theta[0] * torch.exp(-theta[1] * t) + theta[2] - data

    start = torch.tensor([1.0, 0.1, 0.0], dtype=torch.float64)
    ours = levenberg_marquardt(Problem(residual), start, LmOptions())
    peer = least_squares(
        lambda x: residual(torch.tensor(x)).numpy(), start.numpy(), method="lm", xtol=1e-12
    )
    np.testing.assert_allclose(ours.theta, peer.x, rtol=1e-6)
    assert ours.cost == pytest.approx(peer.cost, rel=1e-9)


def test_cost_never_rises_and_the_callback_can_stop():
    costs = []

    def note(state):
        costs.append(state.cost)
        return len(costs) == 5

    start = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    state = levenberg_marquardt(Problem(rosenbrock), start, LmOptions(), note)
    assert state.stopped == "callback"
    assert state.iteration == 5
    assert all(b < a for a, b in itertools.pairwise(costs))


def test_going_on_from_a_state_changes_nothing():
    start = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    whole = levenberg_marquardt(Problem(rosenbrock), start, LmOptions(max_iterations=12))
    half = levenberg_marquardt(Problem(rosenbrock), start, LmOptions(max_iterations=5))
    assert half.stopped == "iterations"
    rest = levenberg_marquardt(
        Problem(rosenbrock), half._replace(stopped=""), LmOptions(max_iterations=12)
    )
    assert torch.equal(rest.theta, whole.theta)
    assert rest[1:] == whole[1:]


def test_steps_into_divergence_are_taken_back():
    def steep(theta):
        return torch.exp(theta) - 3.0

    start = torch.tensor([-6.0], dtype=torch.float64)
    options = LmOptions(initial_damping=1e-12)
    state = levenberg_marquardt(Problem(steep), start, options)
    assert float(state.theta) == pytest.approx(np.log(3.0))


def test_a_singular_problem_is_no_obstacle():
    state = levenberg_marquardt(
        Problem(lambda theta: torch.stack([theta[0] + theta[1] - 2.0, 0.0 * theta[1]])),
        torch.zeros(2).double(),
        LmOptions(),
    )
    assert float(state.theta.sum()) == pytest.approx(2.0)


def test_a_start_that_diverges_is_an_error():
    with pytest.raises(FitError, match="iteration 0 is inf"):
        levenberg_marquardt(
            Problem(lambda theta: torch.exp(theta)), torch.tensor([1e4]).double(), LmOptions()
        )
    with pytest.raises(ConfigError, match="ridge -1"):
        LmOptions(ridge=-1.0)
    assert start_state(torch.zeros(2)).theta.dtype == torch.float64
