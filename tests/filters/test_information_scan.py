"""Measurements as information against measurements in rows, one step after another."""

import pytest
import torch
from torch import Tensor

from navlearn.filters.information_scan import InformationSteps, filter_information, informed
from navlearn.filters.scan import LinearSteps, filter_in_turn


def system(
    count: int, n: int = 4, r: int = 6, batch: tuple[int, ...] = (), seed: int = 0
) -> tuple[Tensor, Tensor, LinearSteps]:
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*batch, *shape, generator=g, dtype=torch.float64)

    eye = torch.eye(n, dtype=torch.float64)
    root = 0.3 * normal(count, n, n)
    steps = LinearSteps(
        eye + 0.1 * normal(count, n, n),
        normal(count, n),
        root @ root.transpose(-1, -2),
        normal(count, r, n),
        0.1 + normal(count, r) ** 2,
        normal(count, r),
    )
    # every third step measures nothing, every fourth only a row
    there = torch.ones(count, r, dtype=torch.float64)
    there[2::3] = 0.0
    there[3::4, 1:] = 0.0
    steps = steps._replace(
        observation=steps.observation * there.unsqueeze(-1), measurement=steps.measurement * there
    )
    return normal(n), (1.0 + 1e4 * eye).expand(*batch, n, n), steps


def as_information(steps: LinearSteps) -> InformationSteps:
    weighted = steps.observation.transpose(-1, -2) / steps.variance.unsqueeze(-2)
    return InformationSteps(
        *steps[:3],
        weighted @ steps.observation,
        (weighted @ steps.measurement.unsqueeze(-1)).squeeze(-1),
    )


@pytest.mark.parametrize("chunk", [None, 1, 4, 30, 100])
@pytest.mark.parametrize("batch", [(), (2,), (20,)])
def test_it_is_the_filter_in_turn(chunk: int | None, batch: tuple[int, ...]) -> None:
    mean, covariance, steps = system(30, batch=batch)
    expected = filter_in_turn(mean, covariance, steps)
    found = filter_information(mean, covariance, as_information(steps), chunk)
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-8, atol=1e-8)


def test_an_unknown_start_stays_positive_beside_fine_measurements() -> None:
    mean, _, steps = system(20, seed=3)
    covariance = torch.diag(torch.tensor([1e8, 1e-8, 1.0, 1e6], dtype=torch.float64))
    fine = steps._replace(variance=0.01 * steps.variance)
    found = filter_information(mean, covariance, as_information(fine))
    assert float(torch.linalg.eigvalsh(found.covariance).min()) > 0.0
    expected = filter_in_turn(mean, covariance, fine)
    torch.testing.assert_close(found.mean, expected.mean, rtol=1e-5, atol=1e-6)


def test_no_information_changes_nothing() -> None:
    mean, covariance, _ = system(1)
    nothing = torch.zeros_like(covariance)
    after, spread = informed(mean, covariance, nothing, torch.zeros_like(mean))
    torch.testing.assert_close(after, mean, rtol=0.0, atol=0.0)
    torch.testing.assert_close(spread, covariance)


def test_it_is_differentiable() -> None:
    mean, covariance, steps = system(6, n=2, r=2, seed=5)
    covariance = 1e-4 * covariance

    def run(*parts: Tensor) -> tuple[Tensor, ...]:
        given = as_information(LinearSteps(*parts))
        return tuple(filter_information(mean, covariance, given, 2))

    leaves = [x.clone().requires_grad_() for x in steps]
    assert torch.autograd.gradcheck(run, leaves)
