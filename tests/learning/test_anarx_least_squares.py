"""Normal equations against automatic differentiation, and minima against SciPy's."""

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares
from torch.func import jacrev

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.anarx_jacobian import pack_weights
from navlearn.error_models.scaling import fit_scaling
from navlearn.learning.anarx_least_squares import AnarxLeastSquares
from navlearn.learning.initialise import random_start
from navlearn.learning.levenberg_marquardt import LmOptions, levenberg_marquardt
from navlearn.learning.windows import check_windows, windows_from_series


def noisy_windows(rows=400, *, length=20, warmup=0, seed=0, outputs=2):
    """Windows of a nonlinear system that no ANARX network meets exactly."""
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(rows, 2, generator=generator).double()
    noise = 0.1 * torch.randn(rows, outputs, generator=generator).double()
    y = torch.zeros(rows, outputs).double()
    for k in range(1, rows):
        y[k] = 0.6 * y[k - 1] + torch.tanh(u[k, 0] * u[k - 1, 1]) + 0.3 * u[k, 1] + noise[k]
    windows = windows_from_series(u, y, length=length, stride=length, warmup=warmup)
    weight = windows.weight * torch.rand(windows.weight.shape, generator=generator).double()
    return check_windows(windows._replace(weight=weight))


def problem_of(windows, *, closed, accumulate=False, block_bytes=8_000_000, **options):
    options = {"lags": 2, "hidden": 2, **options}
    model = Anarx(AnarxOptions(inputs=windows.u.shape[-1], outputs=windows.y.shape[-1], **options))
    ones = torch.ones(windows.u.shape[:2]).double()
    model.set_scaling(fit_scaling(windows.u, ones), fit_scaling(windows.y, ones))
    return AnarxLeastSquares(
        model, windows, closed=closed, accumulate=accumulate, block_bytes=block_bytes
    )


@pytest.mark.parametrize("block_bytes", [1, 20_000, 100_000_000])
@pytest.mark.parametrize(("closed", "accumulate"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("warmup", [0, 3])
def test_normal_equations_equal_automatic_differentiation(closed, accumulate, warmup, block_bytes):
    windows = noisy_windows(120, warmup=warmup)
    problem = problem_of(windows, closed=closed, accumulate=accumulate, block_bytes=block_bytes)
    generator = torch.Generator().manual_seed(3)
    theta = 0.5 * random_start(problem_of(windows, closed=False), generator, feedback=True)
    jacobian = jacrev(problem.residuals)(theta).reshape(-1, theta.shape[0])
    residual = problem.residuals(theta)
    weight = problem.data.weight.unsqueeze(-1).expand(residual.shape).reshape(-1)
    residual = residual.reshape(-1)
    found = problem.normal_equations(theta)
    exact = jacobian.T @ (weight.unsqueeze(1) * jacobian)
    torch.testing.assert_close(found.gram, exact, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(
        found.gradient, jacobian.T @ (weight * residual), rtol=1e-9, atol=1e-9
    )
    assert found.cost == pytest.approx(0.5 * float(weight @ residual**2), rel=1e-12)
    assert found.cost == pytest.approx(problem.cost(theta), rel=1e-12)


@pytest.mark.parametrize("closed", [False, True])
def test_same_minimum_as_scipy_from_the_same_start(closed):
    """Near a noisy system of the family both must end in the same place."""
    generator = torch.Generator().manual_seed(7)
    model = Anarx(AnarxOptions(inputs=2, lags=2, hidden=1, linear_path=False, safeguard=False))
    with torch.no_grad():
        for parameter in (model.weight, model.bias, model.out, model.offset):
            parameter.copy_(1.5 * torch.randn(parameter.shape, generator=generator).double())
        u = torch.randn(201, 2, generator=generator).double()
        clean = model(u)
    y = clean + 0.05 * torch.randn(clean.shape, generator=generator).double()
    windows = check_windows(windows_from_series(u, y, length=20, stride=20))
    problem = AnarxLeastSquares(model, windows, closed=closed)
    truth = pack_weights(model.weights(), False).detach()
    start = truth + 0.1 * torch.randn(truth.shape, generator=generator).double()
    ours = levenberg_marquardt(problem, start, LmOptions(max_iterations=100))
    peer = least_squares(
        lambda x: problem.residuals(torch.tensor(x)).reshape(-1).numpy(),
        start.numpy(),
        method="lm",
        xtol=1e-12,
        ftol=1e-12,
    )
    assert problem.cost(start) > 1.5 * ours.cost
    assert ours.cost == pytest.approx(peer.cost, rel=1e-7)
    np.testing.assert_allclose(ours.theta, peer.x, rtol=0, atol=1e-3)


def test_the_linear_part_of_a_start_cannot_be_improved():
    """A start's output layer solves its linear least squares: its gradient there vanishes."""
    problem = problem_of(noisy_windows(), closed=False, hidden=3)
    theta = random_start(problem, torch.Generator().manual_seed(0), feedback=True)
    gradient = problem.normal_equations(theta).gradient
    blank = problem.normal_equations(torch.zeros_like(theta)).gradient
    n, h, q, p = 2, 3, 4, 2
    by_lag = gradient[:-p].reshape(n, -1)
    solved = torch.cat([by_lag[:, h * q + h :].reshape(-1), gradient[-p:]])
    drawn = by_lag[:, : h * q + h]
    assert float(solved.abs().max()) < 1e-4 * float(blank.abs().max())
    assert float(drawn.abs().max()) > 1e-2 * float(blank.abs().max())


def test_ridge_shrinks_the_start():
    problem = problem_of(noisy_windows(), closed=False)
    sizes = [
        float(
            random_start(problem, torch.Generator().manual_seed(0), feedback=True, ridge=ridge)[
                -2:
            ].norm()
        )
        for ridge in (0.0, 1e2, 1e8)
    ]
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 1e-3 * sizes[0]


def test_a_start_without_feedback_has_none():
    problem = problem_of(noisy_windows(), closed=True)
    theta = random_start(problem, torch.Generator().manual_seed(0), feedback=False)
    other = problem.data.before + 7.0
    moved = problem.residuals(theta)
    problem.data = problem.data._replace(before=other)
    torch.testing.assert_close(problem.residuals(theta), moved, rtol=0, atol=1e-12)


def test_warm_up_rows_are_not_scored():
    windows = noisy_windows(200, warmup=3)
    wild = windows.weight.clone()
    wild[:, :3] = 1e6
    a = problem_of(windows, closed=True)
    b = problem_of(windows._replace(weight=wild), closed=True)
    theta = random_start(a, torch.Generator().manual_seed(1), feedback=False)
    assert a.cost(theta) == b.cost(theta)
