"""Roots of covariances against the covariances themselves."""

import pytest
import torch

from navlearn.filters import ekf
from navlearn.filters.square_root import (
    predicted_root,
    root_of,
    root_of_sum,
    triangular,
    updated_root,
)


def draw(g, *shape):
    return torch.randn(*shape, generator=g, dtype=torch.float64)


def square(root):
    return root @ root.transpose(-1, -2)


@pytest.fixture
def g():
    return torch.Generator().manual_seed(2)


@pytest.mark.parametrize("columns", [2, 4, 9])
def test_a_root_keeps_its_square_as_a_triangle(g, columns):
    M = draw(g, 3, 4, columns)
    found = triangular(M)
    torch.testing.assert_close(square(found), square(M), rtol=1e-13, atol=1e-13)
    assert torch.equal(found, found.tril())
    assert bool((found.diagonal(dim1=-2, dim2=-1) >= 0.0).all())


def test_prediction_and_update_are_those_of_covariances(g):
    root, F, H = triangular(draw(g, 5, 4, 4)), draw(g, 5, 4, 4), draw(g, 5, 3, 4)
    noise, variance, innovation = draw(g, 5, 4, 2), 0.1 + draw(g, 5, 3).abs(), draw(g, 5, 3)
    prior = predicted_root(root, F, noise)
    P = ekf.propagated(square(root), F, square(noise))
    torch.testing.assert_close(square(prior), P, rtol=1e-12, atol=1e-12)
    found = updated_root(prior, H, torch.diag_embed(variance.sqrt()), innovation)
    expected = ekf.update(P, H, variance, innovation)
    torch.testing.assert_close(found.gain, expected.gain, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(found.correction, expected.correction, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(square(found.root), expected.covariance, rtol=1e-10, atol=1e-10)


def test_measurements_may_be_noisy_together(g):
    """By conditioning the joint normal of state and measurement."""
    root, H, R = triangular(draw(g, 4, 4)), draw(g, 2, 4), square(draw(g, 2, 2))
    found = updated_root(root, H, root_of(R), draw(g, 2))
    P = square(root)
    K = P @ H.T @ torch.linalg.inv(H @ P @ H.T + R)
    torch.testing.assert_close(found.gain, K, rtol=1e-11, atol=1e-11)
    torch.testing.assert_close(square(found.root), P - K @ H @ P, rtol=1e-10, atol=1e-11)


def test_a_huge_prior_meets_a_tiny_noise():
    """Where P − K H P keeps nothing: 1e9 m of doubt against a millimetre."""
    root = torch.diag(torch.tensor([1e9, 1.0], dtype=torch.float64))
    H = torch.tensor([[1.0, 1e-3]], dtype=torch.float64)
    sigma = torch.tensor([[1e-3]], dtype=torch.float64)
    found = square(updated_root(root, H, sigma, torch.zeros(1, dtype=torch.float64)).root)
    # east is known to a millimetre and what north has left: 1e-6 + 1e-6; a covariance of 1e18
    # keeps no digit below 100 m²
    assert float(found[0, 0]) == pytest.approx(2e-6, rel=1e-3)
    assert float(found[1, 1]) == pytest.approx(1.0, rel=1e-12)


def test_a_state_without_variance_stays_without(g):
    root = triangular(draw(g, 4, 4))
    root[2], root[:, 2] = 0.0, 0.0
    assert torch.equal(root_of(square(root))[2], torch.zeros(4, dtype=torch.float64))
    prior = root_of_sum(root, torch.zeros(4, 1, dtype=torch.float64))
    torch.testing.assert_close(square(prior), square(root), rtol=1e-13, atol=1e-13)
    H, one = draw(g, 2, 4), torch.eye(2, dtype=torch.float64)
    found = updated_root(prior, H, one, draw(g, 2))
    assert torch.equal(found.root[2], torch.zeros(4, dtype=torch.float64))
    assert float(found.correction[2]) == 0.0
    expected = ekf.update(square(root), H, torch.ones(2, dtype=torch.float64), draw(g, 2))
    torch.testing.assert_close(square(found.root), expected.covariance, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("rank", [0, 1, 3, 5])
def test_the_root_of_a_singular_covariance(g, rank):
    M = draw(g, 4, 5, rank)
    found = root_of(square(M))
    torch.testing.assert_close(square(found), square(M), rtol=1e-12, atol=1e-12)
    assert torch.equal(found, found.tril())


def test_gradients_pass_also_where_a_state_has_no_variance(g):
    root, H, y = draw(g, 4, 4), draw(g, 2, 4), draw(g, 2)
    noise = 0.3 * torch.eye(2, dtype=torch.float64)

    def end(scale, F, sigma):
        start = torch.diag_embed(scale) @ root
        prior = predicted_root(triangular(start), F, 0.1 * torch.diag_embed(scale))
        new = updated_root(prior, H, sigma * noise, y)
        return square(new.root), new.correction

    scale = torch.tensor([1.0, 0.5, 2.0, 1.5], dtype=torch.float64, requires_grad=True)
    F = (torch.eye(4, dtype=torch.float64) + 0.1 * draw(g, 4, 4)).requires_grad_()
    sigma = torch.tensor(1.3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(end, (scale, F, sigma), rtol=1e-6, atol=1e-8)
    none = torch.tensor([1.0, 0.5, 0.0, 1.5], dtype=torch.float64, requires_grad=True)
    still = torch.eye(4, dtype=torch.float64)
    found = torch.autograd.grad(end(none, still, sigma)[0].sum(), (none, sigma))
    assert all(bool(torch.isfinite(x).all()) for x in found)


def ill_conditioned(seed, steps, batch=8):
    """Random systems whose states differ by 1e6 in size, rarely and sharply measured.

    Covariances run beside without Joseph's form, as (I − K H) P.
    """
    g = torch.Generator().manual_seed(seed)
    size = torch.logspace(-3.0, 3.0, 6, dtype=torch.float64)
    turn = torch.linalg.qr(draw(g, batch, 6, 6))[0]
    F = size.unsqueeze(-1) * turn * (1.0 / size)
    noise = (1e-3 * torch.diag(size)).expand(batch, 6, 6)
    H = draw(g, batch, 2, 6) / size
    sharp = (1e-7 * torch.eye(2, dtype=torch.float64)).expand(batch, 2, 2)
    root = torch.diag(1e3 * size).expand(batch, 6, 6)
    P, lost = square(root), 0
    eye, zero = torch.eye(6, dtype=torch.float64), torch.zeros(batch, 2, dtype=torch.float64)
    for k in range(steps):
        root = predicted_root(root, F, noise)
        after = updated_root(root, H, sharp, zero)
        if k < 200:
            P = ekf.propagated(P, F, square(noise))
            K = ekf.kalman_gain(P, H, square(sharp).diagonal(dim1=-2, dim2=-1))
            P = (eye - K @ H) @ P
            lost += int((torch.linalg.eigvalsh(0.5 * (P + P.mT) / size / size[:, None]) < 0).sum())
        root = after.root
        if k % 500 == 0 or k == steps - 1:
            spread = square(root) / size / size.unsqueeze(-1)
            assert bool(torch.isfinite(root).all())
            assert bool((root.diagonal(dim1=-2, dim2=-1) > 0.0).all())
            # to rounding: a product of a real root has no other
            least = torch.linalg.eigvalsh(spread)[..., 0]
            assert bool((least > -1e-14 * spread.diagonal(dim1=-2, dim2=-1).amax(-1)).all())
    return lost


def test_covariances_stay_positive_where_the_plain_form_loses_them():
    assert ill_conditioned(0, 1000) > 0


@pytest.mark.slow
def test_covariances_stay_positive_over_a_million_steps():
    """pytest -m slow tests/filters/test_square_root.py: ten minutes on one core."""
    ill_conditioned(1, 1_000_000, batch=2)
