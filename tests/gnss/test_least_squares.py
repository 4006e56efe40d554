"""Weighted least squares of many small problems against NumPy."""

import numpy as np
import pytest
import torch

from navlearn.gnss.fault_exclusion import consistent_part, limits
from navlearn.gnss.least_squares import robust_factors, weighted_least_squares


def double(values: object) -> torch.Tensor:
    return torch.tensor(np.asarray(values, dtype=np.float64))


def test_as_numpy_solves_it() -> None:
    draw = np.random.default_rng(1)
    design, observation = draw.standard_normal((4, 9, 3)), draw.standard_normal((4, 9))
    weight = draw.uniform(0.1, 2.0, (4, 9))
    weight[1, :4] = 0.0
    found = weighted_least_squares(double(design), double(observation), double(weight))
    for k in range(4):
        w = np.diag(weight[k])
        q = np.linalg.inv(design[k].T @ w @ design[k])
        x = q @ design[k].T @ w @ observation[k]
        v = observation[k] - design[k] @ x
        np.testing.assert_allclose(found.estimate[k], x, rtol=1e-10)
        np.testing.assert_allclose(found.cofactor[k], q, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(found.residual[k], v, rtol=1e-9, atol=1e-12)
        assert float(found.square[k]) == pytest.approx(v @ w @ v)
        on = weight[k] > 0.0
        spread = np.diag(np.diag(1.0 / weight[k][on]) - design[k][on] @ q @ design[k][on].T)
        np.testing.assert_allclose(found.normalised[k][on], v[on] / np.sqrt(spread), rtol=1e-8)
        assert (found.normalised[k].numpy()[~on] == 0.0).all()
    assert found.degrees.tolist() == [6, 2, 6, 6]
    assert found.solvable.all()


def test_unknown_that_nothing_touches_is_left_at_zero() -> None:
    design = double([[[1.0, 0.0], [2.0, 0.0], [0.0, 5.0]]])
    found = weighted_least_squares(design, double([[1.0, 2.0, 9.0]]), double([[1.0, 1.0, 0.0]]))
    assert found.estimate[0].tolist() == pytest.approx([1.0, 0.0])
    assert found.observed[0].tolist() == [True, False]
    assert found.degrees.tolist() == [1]
    assert found.solvable.all()


def test_unknowns_that_cannot_be_told_apart() -> None:
    design = double([[[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]], [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]])
    found = weighted_least_squares(design, double(np.ones((2, 3))), double(np.ones((2, 3))))
    assert found.solvable.tolist() == [False, True]
    assert found.estimate[0].tolist() == [0.0, 0.0]
    assert torch.isfinite(found.cofactor).all()


def test_what_controls_nothing_has_no_normalised_residual() -> None:
    """An observation that alone tells an unknown fits always."""
    design = double([[[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    found = weighted_least_squares(design, double([[0.0, 2.0, 1e6]]), double(np.ones((1, 3))))
    assert found.normalised[0, 2] == 0.0
    assert found.normalised[0, :2].abs().tolist() == pytest.approx([2.0**0.5] * 2)


def test_exclusion_of_one_of_many_readings() -> None:
    design = torch.ones(3, 5, 1, dtype=torch.float64)
    reading = double([[0.0, 0.1, -0.1, 50.0, 0.05], [0.0, 0.1, -0.2, 0.0, 0.1], [0, 0, 9, 0, -9]])
    weight = torch.ones_like(reading)

    def solve(rows: torch.Tensor, weight: torch.Tensor) -> object:
        return weighted_least_squares(design[rows], reading[rows], weight)

    first = weighted_least_squares(design, reading, weight)
    left = consistent_part(solve, weight, first, probability=0.999, exclusions=4)  # type: ignore[arg-type]
    assert left.weight[0].tolist() == [1.0, 1.0, 1.0, 0.0, 1.0]
    assert left.weight[1].tolist() == [1.0] * 5
    assert left.weight[2].tolist() == [1.0, 1.0, 0.0, 1.0, 0.0]
    assert left.passed.all()
    none = consistent_part(solve, weight, first, probability=0.999, exclusions=1)  # type: ignore[arg-type]
    assert none.passed.tolist() == [True, True, False]


def test_limits_are_those_of_tables() -> None:
    # χ² of 95 %: 3.841, 5.991, 7.815 for one, two, three degrees
    assert limits(0.95, 3).tolist()[1:] == pytest.approx([3.841, 5.991, 7.815], abs=1e-3)
    assert limits(1.0, 2).tolist() == [float("inf")] * 3


def test_huber_of_a_location() -> None:
    """Five readings, one far off: the estimator's own equation, Σ ψ((x − μ) / s) = 0."""
    reading = double([[1.0, 1.2, 0.9, 1.1, 60.0]])
    design, weight = torch.ones(1, 5, 1, dtype=torch.float64), torch.full((1, 5), 4.0).double()
    plain = weighted_least_squares(design, reading, weight)
    factor = robust_factors(plain, weight, 1.5)
    centre = float(weighted_least_squares(design, reading, weight * factor).estimate)
    bounded = np.clip((reading.numpy() - centre) / 0.5, -1.5, 1.5)
    assert abs(float(bounded.sum())) < 1e-2
    assert factor[0, :4].tolist() == [1.0] * 4
    assert torch.equal(robust_factors(plain, weight, float("inf")), torch.ones(1, 5).double())
