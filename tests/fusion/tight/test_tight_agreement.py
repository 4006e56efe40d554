"""Measurements that agree: against conditional Gaussians, and on faults of every size."""

import pytest
import torch
from torch import Tensor

from navlearn.filters.consistency import chi_square_quantile
from navlearn.fusion.tight.agreement import agreement

LIMIT = chi_square_quantile(0.999, 1)


def spread_of(seed: int, count: int, clock: float) -> Tensor:
    """Covariance of ranges: white, a position of two metres, and a clock that all share."""
    g = torch.Generator().manual_seed(seed)
    unit = torch.randn(count, 3, generator=g, dtype=torch.float64)
    unit = unit / unit.norm(dim=-1, keepdim=True)
    one = torch.ones(count, 1, dtype=torch.float64)
    return torch.eye(count).double() + 4.0 * unit @ unit.T + clock**2 * one @ one.T


def conditional_square(nu: Tensor, S: Tensor, i: int, rest: list[int]) -> float:
    """Squared distance of one from what the prediction and some others say of it."""
    if not rest:
        return float(nu[i] ** 2 / S[i, i])
    A, b = S[rest][:, rest], S[rest, i]
    told = b @ torch.linalg.solve(A, nu[rest])
    return float((nu[i] - told) ** 2 / (S[i, i] - b @ torch.linalg.solve(A, b)))


@pytest.mark.parametrize("seed", range(4))
def test_squares_are_those_of_conditional_gaussians(seed: int) -> None:
    S = spread_of(seed, 7, 30.0)
    nu = (
        torch.linalg.cholesky(S)
        @ torch.randn(7, generator=torch.Generator().manual_seed(seed)).double()
    )
    nu[2] += 15.0
    nu[5] -= 12.0
    found = agreement(nu, S, torch.ones(7, dtype=torch.bool), LIMIT)
    # the oracle takes out the worst one after another
    left = list(range(7))
    while True:
        squares = [conditional_square(nu, S, i, [j for j in left if j != i]) for i in left]
        worst = max(range(len(left)), key=squares.__getitem__)
        if squares[worst] <= LIMIT:
            break
        assert float(found.square[left[worst]]) == pytest.approx(squares[worst], rel=1e-8)
        del left[worst]
    assert [i for i in range(7) if bool(found.accepted[i])] == left
    want = torch.tensor(squares, dtype=torch.float64)
    torch.testing.assert_close(found.square[left], want, rtol=1e-8, atol=1e-10)
    assert 2 not in left
    assert 5 not in left


@pytest.mark.parametrize("fault", [25.0, 1e3, 1e5, 1e8])
@pytest.mark.parametrize("clock", [1.0, 1e4])
def test_a_single_fault_takes_no_other_with_it(fault: float, clock: float) -> None:
    count, runs = 7, 400
    S = torch.stack([spread_of(k, count, clock) for k in range(runs)])
    white = torch.randn(runs, count, 1, generator=torch.Generator().manual_seed(0)).double()
    nu = (torch.linalg.cholesky(S) @ white).squeeze(-1)
    nu[:, 3] += fault
    found = agreement(nu, S, torch.ones(runs, count, dtype=torch.bool), LIMIT)
    others = [k for k in range(count) if k != 3]
    assert float(found.accepted[:, 3].double().mean()) < 0.005
    # a share of a thousandth each is what the gate refuses of good ones
    assert float(found.accepted[:, others].double().mean()) > 0.995


def test_marginal_gates_would_miss_what_a_clock_hides() -> None:
    S = spread_of(1, 8, 1e4)
    nu = torch.full((8,), 9000.0, dtype=torch.float64)
    nu[4] += 40.0
    assert bool((nu * nu / S.diagonal() < 1.0).all())
    found = agreement(nu, S, torch.ones(8, dtype=torch.bool), LIMIT)
    assert found.accepted.tolist() == [k != 4 for k in range(8)]


def test_a_batch_is_judged_as_its_members_are() -> None:
    g = torch.Generator().manual_seed(3)
    S = torch.stack([spread_of(k, 6, 5.0) for k in range(5)])
    nu = 4.0 * torch.randn(5, 6, generator=g, dtype=torch.float64)
    nu[1, 2], nu[3, :3] = 500.0, 40.0
    there = torch.rand(5, 6, generator=g) < 0.8
    nu = torch.where(there, nu, 0.0)
    both = there.unsqueeze(-1) & there.unsqueeze(-2)
    S = torch.where(both, S, torch.eye(6).double())
    whole = agreement(nu, S, there, LIMIT)
    for k in range(5):
        alone = agreement(nu[k], S[k], there[k], LIMIT)
        assert alone.accepted.tolist() == whole.accepted[k].tolist()
        torch.testing.assert_close(alone.square, whole.square[k])
        kept = there[k].nonzero().squeeze(-1)
        fewer = agreement(nu[k, kept], S[k][kept][:, kept], there[k, kept], LIMIT)
        assert fewer.accepted.tolist() == whole.accepted[k, kept].tolist()
    assert not bool((whole.accepted & ~there).any())


def test_an_open_gate_passes_everything() -> None:
    S = spread_of(1, 5, 1.0)
    there = torch.ones(5, dtype=torch.bool)
    found = agreement(torch.full((5,), 1e6).double(), S, there, float("inf"))
    assert bool(found.accepted.all())


def test_nothing_agrees_with_what_is_no_covariance() -> None:
    S = torch.stack([spread_of(1, 4, 1.0), -spread_of(1, 4, 1.0), 0.0 * spread_of(1, 4, 1.0)])
    S = torch.cat((S, torch.full((1, 4, 4), torch.nan).double()))
    found = agreement(
        torch.full((4, 4), 0.1).double(), S, torch.ones(4, 4, dtype=torch.bool), LIMIT
    )
    assert found.accepted.all(-1).tolist() == [True, False, False, False]
    assert found.accepted.any(-1).tolist() == [True, False, False, False]
    assert bool((found.square[1:] == torch.inf).all())
