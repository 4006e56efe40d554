"""The ridge against numpy: whole, and origin by origin from sums."""

import numpy as np
import pytest
import torch

from navlearn.errors import ShapeError
from navlearn.learning.weighted_ridge import solve_ridge


def problem(rows: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    prior = np.array([0.03, 0.009, 5e-4, 1e-2])
    theta = rng.standard_normal(4) * prior
    columns = rng.standard_normal((rows, 4)) / prior * 0.3
    return columns, columns @ theta + rng.standard_normal(rows), prior


def test_every_origin_equals_a_fit_from_scratch() -> None:
    columns, target, prior = problem()
    counts = torch.tensor([0, 3, 3, 57, 200, 400])
    found = solve_ridge(*map(torch.from_numpy, (columns, target, prior)), counts)
    for k, count in enumerate(counts.tolist()):
        # rows of the prior below those of the data, solved by orthogonal least squares
        whole = np.vstack((columns[:count], np.diag(1.0 / prior)))
        right = np.concatenate((target[:count], np.zeros(4)))
        theta = np.linalg.lstsq(whole, right, rcond=None)[0]
        covariance = np.linalg.inv(whole.T @ whole)
        np.testing.assert_allclose(found.coefficients[k].numpy() / prior, theta / prior, atol=1e-9)
        scale = np.outer(prior, prior)
        np.testing.assert_allclose(
            found.covariance[k].numpy() / scale, covariance / scale, atol=1e-9
        )
        left = np.sum((whole @ theta - right) ** 2) / max(count, 1)
        assert float(found.chi_square[k]) == pytest.approx(left, abs=1e-9)


def test_coefficients_err_as_their_covariance_says() -> None:
    rng = np.random.default_rng(6)
    columns, _, prior = problem(60)
    squares = []
    for _ in range(300):
        theta = rng.standard_normal(4) * prior
        target = columns @ theta + rng.standard_normal(60)
        found = solve_ridge(*map(torch.from_numpy, (columns, target, prior)), torch.tensor([60]))
        error = found.coefficients[0].numpy() - theta
        squares.append(error @ np.linalg.solve(found.covariance[0].numpy(), error))
    # the mean of 300 draws of chi-square with 4 degrees, 99.9 %
    assert np.mean(squares) == pytest.approx(4.0, abs=3.3 * np.sqrt(8.0 / 300.0))


def test_wrong_counts_and_shapes_are_refused() -> None:
    columns, target, prior = (torch.from_numpy(part) for part in problem(10))
    for counts in ([5, 4], [11], [-1]):
        with pytest.raises(ShapeError, match="counts"):
            solve_ridge(columns, target, prior, torch.tensor(counts))
    with pytest.raises(ShapeError, match="expected"):
        solve_ridge(columns, target[:-1], prior, torch.tensor([3]))
