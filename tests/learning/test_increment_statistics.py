"""What is white and what wanders, against series whose noise is known."""

import math

import pytest
import torch

from navlearn.learning.increment_statistics import (
    fitted,
    random_walk,
    sums_over,
    white_density,
    window_values,
)

PLACE = torch.arange(6000)


def normal(count: int, seed: int) -> torch.Tensor:
    return torch.randn(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("drifting", [True, False])
def test_white_noise_is_found_by_both_forms(drifting: bool) -> None:
    found = white_density(3.0 * normal(6000, 1), PLACE, 2.0, drifting=drifting)
    assert found == pytest.approx(9.0 / 2.0, rel=0.06)


def test_a_drift_beneath_does_not_count_as_white() -> None:
    drift = torch.linspace(0.0, 50.0, 6000, dtype=torch.float64)
    error = normal(6000, 2) + drift
    assert white_density(error, PLACE, 1.0, drifting=True) == pytest.approx(1.0, rel=0.06)
    assert white_density(error, PLACE, 1.0, drifting=False) > 100.0


def test_changes_over_a_gap_do_not_count() -> None:
    place = torch.cat((torch.arange(10), torch.arange(20, 30)))
    error = torch.where(place < 15, 0.0, 100.0).double()
    assert white_density(error, place, 1.0, drifting=True) == 0.0


def test_a_random_walk_is_found_beneath_white_noise() -> None:
    walk, seconds = 0.02, 60
    wandering = walk * torch.cumsum(normal(6000, 3), 0)
    by = torch.ones(6000, dtype=torch.float64)
    values = window_values(
        wandering + 0.5 * normal(6000, 4), by, 0.25 * torch.ones_like(by), PLACE, seconds
    )
    found = random_walk(values, float(seconds))
    assert found == pytest.approx(walk, rel=0.3)
    assert values.variance[3] == pytest.approx(0.25 / seconds)


def test_no_walk_is_bounded_by_its_own_deviation() -> None:
    by = torch.ones(6000, dtype=torch.float64)
    values = window_values(normal(6000, 5), by, by, PLACE, 60)
    found = random_walk(values, 60.0)
    assert found is not None
    assert 0.0 < found < 2.0 * math.sqrt(math.sqrt(2.0 / 99.0) / 60.0 * 3.0 / 60.0)


def test_too_few_neighbours_tell_no_walk() -> None:
    place = torch.cat([torch.arange(60) + 120 * k for k in range(20)])  # every other minute
    by = torch.ones(len(place), dtype=torch.float64)
    assert random_walk(window_values(normal(1200, 6), by, by, place, 60), 60.0) is None


def test_window_values_are_weighted_least_squares() -> None:
    by, variance = 1.0 + normal(50, 7) ** 2, 0.1 + normal(50, 8) ** 2
    error = 2.5 * by + normal(50, 9)
    found = window_values(error, by, variance, torch.arange(50), 50)
    root = variance.sqrt()
    solved = torch.linalg.lstsq((by / root)[:, None], (error / root)[:, None]).solution
    assert float(found.value) == pytest.approx(float(solved))


def test_sums_are_those_of_whole_windows_alone() -> None:
    place = torch.tensor([0, 1, 2, 3, 5, 6, 7, 8])  # 4 is missing
    values = torch.arange(8, dtype=torch.float64)
    assert sums_over(values, place, 3).tolist() == [3.0, 18.0]


def test_a_fit_with_levels_equals_one_with_a_column_per_window() -> None:
    place = torch.arange(90)
    by = torch.stack((normal(90, 10), normal(90, 11)), -1)
    level = torch.repeat_interleave(torch.tensor([5.0, -3.0, 1.0], dtype=torch.float64), 30)
    error = by @ torch.tensor([0.7, -0.2], dtype=torch.float64) + level + 0.1 * normal(90, 12)
    columns = torch.nn.functional.one_hot(place // 30).double()
    direct = torch.linalg.lstsq(torch.cat((by, columns), -1), error[:, None]).solution[:2, 0]
    torch.testing.assert_close(fitted(error, by, place, 30), direct)


def test_a_regressor_of_zeros_gets_zero() -> None:
    by = torch.stack((torch.zeros(20), torch.ones(20)), -1).double()
    torch.testing.assert_close(
        fitted(torch.full((20,), 3.0).double(), by), torch.tensor([0.0, 3.0]).double()
    )
    assert fitted(torch.ones(4).double(), torch.zeros((4, 0)).double()).shape == (0,)
