"""Which cascades PCI accepts: on noise, on slow series, and in strong noise."""

import math

import pytest
import torch
from scipy.stats import chi2

from navlearn.error_models.pci import PciOptions
from navlearn.error_models.pci_acceptance import (
    acceptance_threshold,
    autocorrelations,
    effective_rows,
)
from navlearn.error_models.pci_fit import fit_pci, fit_pci_windows

FIRST = (1.0, 0.6, 0.2, -0.3)


def noise(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


def filtered(x, response):
    return sum(
        g * torch.cat((x[:1].expand(j, 1), x[: len(x) - j])) for j, g in enumerate(response)
    )[:, 0]


def accepted_on_noise(options, draws, rows, memory):
    """Number of draws in which noise is taken for a system."""
    x, y = noise(draws, rows, options.inputs), noise(draws, rows, seed=1)
    for k in range(1, rows):
        x[:, k] = memory * x[:, k - 1] + math.sqrt(1.0 - memory**2) * x[:, k]
    return sum(fitted.cascades > 0 for fitted in fit_pci_windows(x, y, options))


SHAPES = [
    ({}, 0.0),
    ({}, 0.9),
    ({"lags": 1, "degree": 5}, 0.0),
    ({"inputs": 3, "lags": 3}, 0.0),
    pytest.param({"batch": 256}, 0.0, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("shape", "memory"), SHAPES)
def test_the_default_rule_refuses_noise(shape, memory):
    assert accepted_on_noise(PciOptions(cascades=2, **shape), 200, 300, memory) <= 10


@pytest.mark.parametrize(("memory", "often"), [(0.0, 180), (0.9, 120)])
def test_the_papers_rule_takes_noise(memory, often):
    assert accepted_on_noise(PciOptions.paper(), 200, 300, memory) > often


def test_the_default_threshold_is_the_quantile_of_chi_squared():
    freedom, rows = torch.tensor([2.0, 14.0, 60.0]).double(), torch.tensor([600.0, 80.0]).double()
    share = acceptance_threshold(rows, freedom, 3, 0.02, False)
    quantile = torch.from_numpy(chi2.isf(0.02 / 3, freedom.numpy()))
    torch.testing.assert_close(
        share, -torch.expm1(-quantile / rows.unsqueeze(-1)), rtol=1e-10, atol=0
    )
    paper = acceptance_threshold(rows, freedom, 3, 0.02, True)
    assert paper.tolist() == [[4 / 600] * 3, [4 / 80] * 3]


def independent(rows, x, y):
    root = torch.full((1, len(y)), 1.0 / len(y), dtype=torch.float64).sqrt()
    rho_x, rho_y = (autocorrelations(z.unsqueeze(0), root) for z in (x, y.unsqueeze(-1)))
    return float(effective_rows(torch.tensor([rows]).double(), rho_x, rho_y))


def test_effective_rows_equal_plain_loops():
    x, y = noise(50, 1).cumsum(0), noise(50, seed=1).cumsum(0)

    def correlation(z, j):
        z = z - z.mean()
        return float((z[j:] * z[: 50 - j]).sum() / (z * z).sum())

    total = 1 + 2 * sum(correlation(x[:, 0], j) * correlation(y, j) for j in range(1, 12))
    assert independent(50.0, x, y) == pytest.approx(max(50 / total, 1.0), rel=1e-9)
    assert 480 < independent(600.0, noise(600, 1), noise(600, seed=1)) <= 600


def test_two_random_walks_are_not_taken_for_cause_and_effect():
    accepted = [
        fit_pci(
            noise(600, 1, seed=2 * k).cumsum(0),
            noise(600, seed=2 * k + 1).cumsum(0),
            PciOptions(cascades=1, seed=k),
        ).cascades
        for k in range(40)
    ]
    assert sum(accepted) <= 4


def test_a_slow_cause_is_still_found():
    x = filtered(noise(600, 1), [0.1] * 10).unsqueeze(-1)
    y = filtered(x, FIRST)
    y = y + 0.5 * y.std() * noise(600, seed=1)
    assert fit_pci(x, y, PciOptions()).cascades >= 1


def test_a_weak_system_in_strong_noise_is_found():
    x = noise(600, 1, seed=3)
    y = filtered(x, FIRST)
    y = y + math.sqrt(3.0) * y.std() * noise(600, seed=4)
    fitted = fit_pci(x, y, PciOptions())
    assert fitted.cascades >= 1
    assert fitted.record.stopped == "none passed"
    assert fitted.record.train_loss < 0.85
