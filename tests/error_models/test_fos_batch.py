import pytest
import torch

from navlearn.error_models.fos_fit import fit_fos, fit_fos_batch
from navlearn.error_models.fos_options import FosOptions
from navlearn.errors import FitError, ShapeError


def windows(count=7, rows=90, correlated=0.7):
    """Return windows, each with a law of its own; the last is noise alone."""
    generator = torch.Generator().manual_seed(3)
    u = torch.randn(count, rows, 3, generator=generator).double()
    for k in range(1, rows):
        u[:, k] = correlated * u[:, k - 1] + (1.0 - correlated**2) ** 0.5 * u[:, k]
    share = torch.randn(count, 4, 1, generator=generator).double()
    share[-1] = 0.0
    y = 0.3 * torch.randn(count, rows, generator=generator).double()
    y[:, 1:] += share[:, 0] * u[:, 1:, 0] + share[:, 1] * u[:, 1:, 1] * u[:, :-1, 2]
    y += share[:, 2] * (share[:, 3] > 0) + share[:, 3] * u[..., 2] ** 2
    return u, y.unsqueeze(-1)


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"degree": 1, "output_lags": 2},
        {"ridge": 0.02, "false_alarm": 1.0, "max_terms": 5},
        {"exchange_sweeps": 5, "backward": True},
        {"exchange_sweeps": 2, "kicks": 4, "false_alarm": 1.0, "max_terms": 4},
        {"acceptance": "paper", "exchange_sweeps": 1, "target_error": 0.4},
    ],
)
def test_batch_equals_one_window_after_another(changed):
    options = FosOptions(**{"lags": 2, **changed})
    u, y = windows()
    weight = 0.1 + torch.rand(7, 90, generator=torch.Generator().manual_seed(4)).double()
    weight[2, 40:] = 0.0
    for given in (None, weight):
        together = fit_fos_batch(u, y, given, options)
        for k, found in enumerate(together):
            expected = fit_fos(u[k], y[k], None if given is None else given[k], options)
            assert found.model.terms == expected.model.terms
            torch.testing.assert_close(
                found.model.coefficients, expected.model.coefficients, rtol=1e-9, atol=1e-12
            )
            torch.testing.assert_close(found.model.variance, expected.model.variance)
            assert found.curves.train == pytest.approx(expected.curves.train, rel=1e-9)
            assert found.record.stopped == expected.record.stopped
            assert found.record.samples == expected.record.samples
    assert len({found.model.terms for found in together}) > 3


def test_wrong_batches_are_refused():
    u, y = windows(3)
    with pytest.raises(ShapeError):
        fit_fos_batch(u[0], y[0])
    weight = torch.ones(3, 90)
    weight[1] = 0.0
    with pytest.raises(FitError):
        fit_fos_batch(u, y, weight)
    weight[1] = 1.0
    u[2, 5, 0] = torch.inf
    with pytest.raises(FitError):
        fit_fos_batch(u, y, weight)
    assert len(fit_fos_batch(u[:2], y[:2])) == 2


def test_a_window_without_weight_counts_for_nothing_in_a_joint_fit():
    u, y = windows(3)
    weight = torch.ones(3, 90)
    weight[1] = 0.0
    joint, other = fit_fos(u, y, weight).model, fit_fos(u[::2], y[::2]).model
    assert joint.terms == other.terms
    torch.testing.assert_close(joint.coefficients, other.coefficients, rtol=1e-9, atol=0)
