"""The linear algebra of the filter against independent ones."""

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
import torch

from navlearn.errors import ConfigError
from navlearn.filters import consistency, discretize, ekf
from navlearn.filters.scan import LinearSteps, filter_in_parallel, filter_in_turn


def random_steps(seed: int, batch: tuple[int, ...], count: int, n: int, r: int) -> LinearSteps:
    g = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*batch, count, *shape, generator=g, dtype=torch.float64)

    root = 0.3 * draw(n, n)
    return LinearSteps(
        torch.eye(n, dtype=torch.float64) + 0.1 * draw(n, n),
        draw(n),
        root @ root.transpose(-1, -2),
        draw(r, n),
        0.1 + draw(r).abs(),
        draw(r),
    )


def joint_gaussian(mean, covariance, steps):
    """Filter by conditioning one joint Gaussian of all states and measurements."""
    F, b, Q, H, R, y = (x.numpy() for x in steps)
    count, n = b.shape
    size = n * (count + 1)
    A = np.eye(size)
    for k in range(count):
        A[n * (k + 1) : n * (k + 2), n * k : n * (k + 1)] = -F[k]
    right = np.concatenate((mean.numpy(), b.ravel()))
    noise = scipy.linalg.block_diag(covariance.numpy(), *Q)
    inverse = np.linalg.inv(A)
    m, P = inverse @ right, inverse @ noise @ inverse.T
    result = []
    for k in range(count):
        C = np.zeros((H.shape[1] * (k + 1), size))
        for j in range(k + 1):
            C[H.shape[1] * j : H.shape[1] * (j + 1), n * (j + 1) : n * (j + 2)] = H[j]
        S = C @ P @ C.T + np.diag(R[: k + 1].ravel())
        G = P @ C.T @ np.linalg.inv(S)
        after, spread = m + G @ (y[: k + 1].ravel() - C @ m), P - G @ C @ P
        part = slice(n * (k + 1), n * (k + 2))
        result.append((after[part], spread[part, part]))
    return result


def test_recursion_equals_the_joint_gaussian():
    steps = random_steps(0, (), 6, 3, 2)
    mean, P = torch.ones(3, dtype=torch.float64), 2.0 * torch.eye(3, dtype=torch.float64)
    found = filter_in_turn(mean, P, steps)
    for k, (m, spread) in enumerate(joint_gaussian(mean, P, steps)):
        np.testing.assert_allclose(found.mean[k].numpy(), m, atol=1e-10)
        np.testing.assert_allclose(found.covariance[k].numpy(), spread, atol=1e-10)


@pytest.mark.parametrize(("count", "chunk"), [(1, None), (7, 3), (30, None), (31, 31), (12, 1)])
def test_parallel_filter_equals_the_recursion(count, chunk):
    steps = random_steps(count, (2,), count, 4, 3)
    mean = torch.ones(2, 4, dtype=torch.float64)
    P = torch.eye(4, dtype=torch.float64).expand(2, 4, 4)
    for a, b in zip(
        filter_in_turn(mean, P, steps), filter_in_parallel(mean, P, steps, chunk), strict=True
    ):
        torch.testing.assert_close(a, b, atol=1e-10, rtol=1e-9)


def test_parallel_filter_has_the_gradient_of_finite_differences():
    steps = random_steps(3, (), 5, 2, 1)
    mean, P = torch.zeros(2, dtype=torch.float64), torch.eye(2, dtype=torch.float64)

    def end(transition, variance, measurement):
        moved = steps._replace(transition=transition, variance=variance, measurement=measurement)
        done = filter_in_parallel(mean, P, moved, 2)
        return done.mean[-1], done.covariance[-1]

    inputs = (steps.transition, steps.variance, steps.measurement)
    assert torch.autograd.gradcheck(end, tuple(x.clone().requires_grad_() for x in inputs))


def test_updates_agree_and_ignore_a_blank_row():
    steps = random_steps(5, (), 1, 4, 3)
    P = steps.noise[0] + torch.eye(4, dtype=torch.float64)
    H, R, y = steps.observation[0], steps.variance[0], steps.measurement[0]
    whole, turn = ekf.update(P, H, R, y), ekf.update_in_turn(P, H, R, y)
    for a, b in zip(whole, turn, strict=True):
        torch.testing.assert_close(a, b, atol=1e-12, rtol=1e-10)
    keep = torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64)
    blank = ekf.update(P, H * keep[:, None], torch.where(keep > 0, R, 1.0), y * keep)
    fewer = ekf.update(P, H[::2], R[::2], y[::2])
    torch.testing.assert_close(blank.correction, fewer.correction, atol=1e-13, rtol=1e-12)
    torch.testing.assert_close(blank.covariance, fewer.covariance, atol=1e-13, rtol=1e-12)


def test_nis_is_the_quadratic_form():
    steps = random_steps(6, (), 1, 4, 3)
    P, H, R, y = steps.noise[0], steps.observation[0], steps.variance[0], steps.measurement[0]
    S = (H @ P @ H.T + torch.diag(R)).numpy()
    expected = y.numpy() @ np.linalg.solve(S, y.numpy())
    assert float(ekf.normalized_square(P, H, R, y)) == pytest.approx(expected, rel=1e-12)


def test_van_loan_equals_quadrature():
    g = torch.Generator().manual_seed(2)
    F = torch.randn(3, 3, generator=g, dtype=torch.float64)
    Qc = torch.diag(torch.tensor([1.0, 0.5, 0.0], dtype=torch.float64))
    transition, noise = discretize.van_loan(F, Qc, torch.tensor(0.7, dtype=torch.float64))
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = np.zeros((3, 3))
    for x, w in zip(0.35 * (nodes + 1.0), 0.35 * weights, strict=True):
        E = scipy.linalg.expm(F.numpy() * x)
        total += w * E @ Qc.numpy() @ E.T
    np.testing.assert_allclose(transition.numpy(), scipy.linalg.expm(0.7 * F.numpy()), atol=1e-12)
    np.testing.assert_allclose(noise.numpy(), total, atol=1e-12)


@pytest.mark.parametrize("degrees", [1, 3, 200])
@pytest.mark.parametrize("probability", [0.025, 0.5, 0.999])
def test_chi_square_quantile_equals_scipy(degrees, probability):
    expected = scipy.stats.chi2.ppf(probability, degrees)
    assert consistency.chi_square_quantile(probability, degrees) == pytest.approx(expected)


def test_chi_square_quantile_refuses_a_probability_of_zero():
    with pytest.raises(ConfigError, match="probability"):
        consistency.chi_square_quantile(0.0, 3)


def test_nees_of_gaussian_draws_lies_in_its_band():
    g = torch.Generator().manual_seed(1)
    root = torch.randn(3, 3, generator=g, dtype=torch.float64)
    errors = torch.randn(4000, 3, generator=g, dtype=torch.float64) @ root.T
    mean = float(consistency.nees(errors, (root @ root.T).expand(4000, 3, 3)).mean())
    band = consistency.mean_band(3, 4000, 0.999)
    assert band.low < mean < band.high
    assert not band.low < 1.1 * mean < band.high


def gnss_like(count: int, variance: float, opened: float) -> LinearSteps:
    """Position, velocity and tilt in three axes; long silence, and noise that is opened anew."""
    g = torch.Generator().manual_seed(1)
    F = torch.eye(9, dtype=torch.float64).repeat(count, 1, 1)
    F[:, :3, 3:6] += torch.eye(3)
    F[:, 3:6, 6:] += 9.8 * torch.eye(3)
    F[:, 6, 7] = 0.03 * torch.randn(count, generator=g)
    F[:, 7, 6] = -F[:, 6, 7]
    Q = torch.diag(torch.tensor([0.0] * 3 + [1e-6] * 3 + [1e-10] * 3, dtype=torch.float64))
    Q = Q.repeat(count, 1, 1)
    H = torch.eye(9, dtype=torch.float64)[:6].repeat(count, 1, 1)
    H[torch.rand(count, generator=g) < 0.2] = 0.0
    H[count // 2 : count // 2 + 200] = 0.0
    for k in (count // 7, count // 2 + 200, count - 300):
        Q[k].diagonal()[:3] += opened**2
        H[k] = torch.eye(9)[:6]
    y = variance**0.5 * torch.randn(count, 6, generator=g, dtype=torch.float64)
    R = torch.full((count, 6), variance, dtype=torch.float64)
    return LinearSteps(F, torch.zeros(count, 9, dtype=torch.float64), Q, H, R, y)


@pytest.mark.parametrize(("variance", "opened"), [(0.09, 1e3), (1e-8, 1e4), (1e-12, 1e6)])
def test_a_long_run_keeps_its_covariances_positive(variance, opened):
    """Behind a tiny R a huge P leaves rounding only; Joseph's textbook form is the oracle."""
    steps = gnss_like(5000, variance, opened)
    sigmas = torch.tensor([opened] * 6 + [0.1] * 3, dtype=torch.float64)
    start = torch.zeros_like(sigmas), torch.diag(sigmas**2)
    oracle = filter_in_turn(*start, steps)
    sigma = oracle.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    for chunk in (None, 5000):
        found = filter_in_parallel(*start, steps, chunk)
        assert torch.equal(found.covariance, found.covariance.mT)
        for P in (found.covariance, found.prior_covariance):
            own = P.diagonal(dim1=-2, dim2=-1).sqrt()
            scaled = P / own.unsqueeze(-1) / own.unsqueeze(-2)
            assert bool(torch.isfinite(scaled).all())
            assert float(torch.linalg.eigvalsh(scaled).min()) > -1e-12
        gap = (found.covariance - oracle.covariance).abs()
        assert float((gap / sigma.unsqueeze(-1) / sigma.unsqueeze(-2)).max()) < 1e-3
        assert float(((found.mean - oracle.mean).abs() / sigma).max()) < 1e-6
