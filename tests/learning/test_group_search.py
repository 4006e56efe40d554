"""Terms common to several records: what is there is found, noise is left alone."""

import pytest
import torch

from navlearn.errors import FitError, ShapeError
from navlearn.learning.group_search import search_groups


def records(coefficients, rows=400, seed=0, noise=1.0):
    """Return correlated candidates and targets, one record per row of coefficients."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    mixing = normal(coefficients.shape[1], coefficients.shape[1]) + 3.0 * torch.eye(
        coefficients.shape[1], dtype=torch.float64
    )
    columns = [normal(rows, coefficients.shape[1]) @ mixing for _ in coefficients]
    targets = [
        x @ theta + noise * normal(rows) for x, theta in zip(columns, coefficients, strict=True)
    ]
    return columns, targets


def test_terms_are_found_though_their_signs_differ():
    g = torch.Generator().manual_seed(3)
    theta = torch.zeros(6, 8, dtype=torch.float64)
    theta[:, [1, 4, 6]] = 0.3 * torch.randn(6, 3, generator=g, dtype=torch.float64)
    found = search_groups(*records(theta), max_terms=8)
    assert set(found.chosen) == {1, 4, 6}
    assert float(found.next_best.sum()) < found.asked
    # a term with coefficients that cancel over the records is no less of a term
    theta[:, 1] = torch.tensor([0.2, -0.2, 0.2, -0.2, 0.2, -0.2])
    assert 1 in search_groups(*records(theta), max_terms=8).chosen


def test_reductions_are_those_of_least_squares():
    theta = torch.zeros(3, 5, dtype=torch.float64)
    theta[:, [0, 3]] = torch.tensor([[1.0, 0.5], [-0.7, 0.9], [0.4, -1.0]], dtype=torch.float64)
    columns, targets = records(theta, noise=0.5)
    found = search_groups(columns, targets, max_terms=5)
    assert set(found.chosen) == {0, 3}
    for d, (x, y) in enumerate(zip(columns, targets, strict=True)):
        everything = y - x @ torch.linalg.lstsq(x, y.unsqueeze(-1)).solution.squeeze(-1)
        noise = everything.square().sum() / (len(y) - 5)
        before = y.square().sum()
        for k in range(len(found.chosen)):
            part = x[:, list(found.chosen[: k + 1])]
            rest = y - part @ torch.linalg.lstsq(part, y.unsqueeze(-1)).solution.squeeze(-1)
            gone = (before - rest.square().sum()) / noise
            assert float(found.reduction[k, d]) == pytest.approx(float(gone), rel=1e-6)
            before = rest.square().sum()


def test_white_noise_has_no_terms():
    nothing = torch.zeros(4, 6, dtype=torch.float64)
    accepted = [
        len(search_groups(*records(nothing, rows=100, seed=seed), max_terms=6).chosen) > 0
        for seed in range(200)
    ]
    assert sum(accepted) <= 17  # 5 % of 200, and two standard deviations


def test_what_cannot_be_searched_is_refused():
    x = torch.ones(50, 3, dtype=torch.float64)
    with pytest.raises(ShapeError, match="a target per record"):
        search_groups([x], [], max_terms=2)
    with pytest.raises(ShapeError, match="against"):
        search_groups([x], [torch.ones(49, dtype=torch.float64)], max_terms=2)
    with pytest.raises(FitError, match="longer drives"):
        search_groups([x[:5]], [torch.ones(5, dtype=torch.float64)], max_terms=2)
    with pytest.raises(FitError, match="not finite"):
        search_groups([x], [torch.full((50,), torch.nan, dtype=torch.float64)], max_terms=2)


def test_a_candidate_that_repeats_another_is_taken_once():
    theta = torch.tensor([[1.0, 0.0], [-1.0, 0.0]], dtype=torch.float64)
    columns, targets = records(theta, seed=2)
    twice = [torch.cat((x, x[:, :1]), 1) for x in columns]
    found = search_groups(twice, targets, max_terms=3)
    assert len(found.chosen) == 1
    assert found.chosen[0] in (0, 2)


def test_a_term_that_one_record_cannot_tell_from_another_does_it_no_harm():
    theta = torch.tensor([[1.0, 0.7, 0.0, 0.9]] * 3, dtype=torch.float64)
    columns, targets = records(theta, seed=4)
    noise = [y - x @ theta[0] for x, y in zip(columns, targets, strict=True)]
    columns[1][:, 1] = 3.0 * columns[1][:, 0]  # such as |ω| on a drive of left turns
    columns[2] = torch.zeros_like(columns[2])  # a car that was parked
    targets[1:] = [columns[1] @ theta[1] + noise[1], noise[2]]
    found = search_groups(columns, targets, max_terms=4)
    assert set(found.chosen) == {0, 1, 3}
    assert bool(torch.isfinite(found.reduction).all())
    part = columns[1][:, [0, 3]]
    target = targets[1].unsqueeze(-1)
    left = target - part @ torch.linalg.lstsq(part, target).solution
    kept = columns[1][:, [0, 2, 3]]
    rest = (target - kept @ torch.linalg.lstsq(kept, target).solution).square().sum()
    gone = (target.square().sum() - left.square().sum()) / (rest / (400 - 4))
    assert float(found.reduction[:, 1].sum()) == pytest.approx(float(gone), rel=1e-5)
    assert float(found.reduction[:, 2].sum()) == 0.0
