import math

import numpy as np
import pytest
import torch
from scipy import stats

from navlearn.errors import ConfigError
from navlearn.filters.likelihood import (
    gaussian_log_density,
    student_log_density,
    student_scale,
    whitened,
)


def _case(rows: int = 3, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    a = torch.randn(rows, rows, generator=g, dtype=torch.float64)
    innovation = torch.randn(rows, generator=g, dtype=torch.float64)
    variance = torch.rand(rows, generator=g, dtype=torch.float64) + 0.1
    return innovation, a @ a.T, variance


def test_gaussian_density_is_that_of_scipy() -> None:
    innovation, spread, variance = _case()
    white = whitened(innovation, spread, variance, torch.ones(3, 3, dtype=torch.float64))
    ours = gaussian_log_density(
        white.square.sum(), white.log_variance.sum(), torch.tensor(3.0, dtype=torch.float64)
    )
    total = (spread + torch.diag(variance)).numpy()
    theirs = stats.multivariate_normal(np.zeros(3), total).logpdf(innovation.numpy())
    assert float(ours) == pytest.approx(theirs, abs=1e-12)


def test_student_density_is_that_of_scipy() -> None:
    innovation, spread, variance = _case(2, 1)
    white = whitened(innovation, spread, variance, torch.ones(2, 2, dtype=torch.float64))
    two = torch.tensor(2.0, dtype=torch.float64)
    ours = student_log_density(white.square.sum(), white.log_variance.sum(), two, 5.0)
    shape = (spread + torch.diag(variance)).numpy() * student_scale(2, 5.0)
    theirs = stats.multivariate_t(np.zeros(2), shape, df=5.0).logpdf(innovation.numpy())
    assert float(ours) == pytest.approx(theirs, abs=1e-10)


def test_rows_one_after_another_make_the_joint_density() -> None:
    innovation, spread, variance = _case(4, 2)
    white = whitened(innovation, spread, variance, torch.ones(4, 4, dtype=torch.float64))
    total = (spread + torch.diag(variance)).numpy()
    nu = innovation.numpy()
    mean = total[2:, :2] @ np.linalg.solve(total[:2, :2], nu[:2])
    left = total[2:, 2:] - total[2:, :2] @ np.linalg.solve(total[:2, :2], total[:2, 2:])
    theirs = stats.multivariate_normal(mean, left).logpdf(nu[2:])
    ours = gaussian_log_density(
        white.square[2:].sum(), white.log_variance[2:].sum(), torch.tensor(2.0, dtype=torch.float64)
    )
    assert float(ours) == pytest.approx(theirs, abs=1e-12)


def test_rows_taken_apart_do_not_tell_of_each_other() -> None:
    innovation, spread, variance = _case(3, 3)
    together = torch.block_diag(torch.ones(2, 2), torch.ones(1, 1)).double()
    apart = whitened(innovation, spread, variance, together)
    wild = innovation.clone()
    wild[:2] += 1e3
    moved = whitened(wild, spread, variance, together)
    assert float(moved.square[2]) == float(apart.square[2])
    assert float(moved.square[0]) > 1e3 * float(apart.square[0])


@pytest.mark.parametrize(("degrees", "freedom"), [(1, 5.0), (2, 3.0), (3, 5.0), (3, 30.0)])
def test_normal_innovations_call_for_their_own_covariance(degrees: int, freedom: float) -> None:
    square = torch.from_numpy(np.random.default_rng(0).chisquare(degrees, 400_000))
    d = torch.full_like(square, degrees)
    factors = torch.linspace(-0.1, 0.1, 41, dtype=torch.float64)
    total = [
        float(student_log_density(square / torch.exp(f), degrees * f, d, freedom).mean())
        for f in factors
    ]
    best = float(factors[int(np.argmax(total))])
    assert abs(best) <= 0.011


def test_student_tends_to_the_normal_density() -> None:
    square = torch.tensor([0.1, 3.0, 12.0], dtype=torch.float64)
    d, none = torch.full_like(square, 3.0), torch.zeros_like(square)
    gap = student_log_density(square, none, d, 1e7) - gaussian_log_density(square, none, d)
    assert float(gap.abs().max()) < 1e-4


def test_where_nothing_is_measured_nothing_counts() -> None:
    zero = torch.zeros(2, dtype=torch.float64)
    assert student_log_density(zero, zero, zero, 5.0).tolist() == [0.0, 0.0]


def test_one_wild_innovation_does_not_decide() -> None:
    wild = torch.tensor(1e6, dtype=torch.float64)
    d, none = torch.tensor(3.0, dtype=torch.float64), torch.tensor(0.0, dtype=torch.float64)
    assert float(gaussian_log_density(wild, none, d)) < -4e5
    assert float(student_log_density(wild, none, d, 5.0)) > -60.0


def test_densities_are_differentiable() -> None:
    innovation, spread, variance = _case(3, 4)
    together = torch.block_diag(torch.ones(2, 2), torch.ones(1, 1)).double()
    d = torch.tensor(3.0, dtype=torch.float64)

    def density(nu: torch.Tensor, root: torch.Tensor, r: torch.Tensor) -> torch.Tensor:
        white = whitened(nu, root @ root.T, r, together)
        return student_log_density(white.square.sum(), white.log_variance.sum(), d, 5.0)

    root = torch.linalg.cholesky(spread + 1e-6 * torch.eye(3, dtype=torch.float64))
    inputs = [x.clone().requires_grad_(True) for x in (innovation, root, variance)]
    assert torch.autograd.gradcheck(density, inputs)


@pytest.mark.parametrize(("degrees", "freedom"), [(0, 5.0), (2, 0.0), (2, math.inf)])
def test_scale_refuses_what_is_no_density(degrees: int, freedom: float) -> None:
    with pytest.raises(ConfigError, match="student_scale"):
        student_scale(degrees, freedom)
