"""The smoother against the joint Gaussian of all states, and its two forms against each other."""

import numpy as np
import pytest
import scipy.linalg
import torch
from torch import Tensor

from navlearn.filters.scan import LinearSteps, filter_in_turn
from navlearn.filters.smoother import (
    Forward,
    Smoothed,
    forward_pass,
    smooth_in_parallel,
    smooth_in_turn,
    smoother_gain,
)

FORMS = [smooth_in_turn, lambda forward: smooth_in_parallel(forward, 3)]


def random_steps(seed: int, batch: tuple[int, ...], count: int, n: int, r: int) -> LinearSteps:
    g = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> Tensor:
        return torch.randn(*batch, count, *shape, generator=g, dtype=torch.float64)

    root = 0.3 * draw(n, n)
    return LinearSteps(
        torch.eye(n, dtype=torch.float64) + 0.1 * draw(n, n),
        draw(n),
        root @ root.transpose(-1, -2),
        draw(r, n),
        0.1 + draw(r).abs(),
        draw(r),
    )


def filtered(mean: Tensor, covariance: Tensor, steps: LinearSteps) -> Forward:
    return forward_pass(mean, covariance, steps, filter_in_turn(mean, covariance, steps))


def joint_gaussian(
    mean: Tensor, covariance: Tensor, steps: LinearSteps
) -> tuple[np.ndarray, np.ndarray]:
    """Condition one Gaussian of all states on all measurements; nothing is inverted but S."""
    F, b, Q, H, R, y = (x.numpy() for x in steps)
    count, n = b.shape
    A = np.eye(n * (count + 1))
    for k in range(count):
        A[n * (k + 1) : n * (k + 2), n * k : n * (k + 1)] = -F[k]
    unroll = np.linalg.inv(A)
    m = unroll @ np.concatenate((mean.numpy(), b.ravel()))
    P = unroll @ scipy.linalg.block_diag(covariance.numpy(), *Q) @ unroll.T
    C = np.hstack((np.zeros((H.shape[1] * count, n)), scipy.linalg.block_diag(*H)))
    S = C @ P @ C.T + np.diag(R.ravel())
    gain = np.linalg.solve(S, C @ P).T
    return m + gain @ (y.ravel() - C @ m), P - gain @ C @ P


def assert_equals_joint(
    found: Smoothed, mean: Tensor, covariance: Tensor, steps: LinearSteps, atol: float
) -> None:
    m, P = joint_gaussian(mean, covariance, steps)
    n, beliefs = mean.shape[0], steps.shift.shape[0] + 1
    np.testing.assert_allclose(found.mean.numpy().ravel(), m, atol=atol)
    for k in range(beliefs):
        here, following = slice(n * k, n * (k + 1)), slice(n * (k + 1), n * (k + 2))
        np.testing.assert_allclose(found.covariance[k].numpy(), P[here, here], atol=atol)
        if k + 1 < beliefs:
            cross = found.gain[k] @ found.covariance[k + 1]
            np.testing.assert_allclose(cross.numpy(), P[here, following], atol=atol)


@pytest.mark.parametrize("form", FORMS)
def test_smoother_equals_the_joint_gaussian(form) -> None:
    steps = random_steps(0, (), 8, 3, 2)
    mean, P = torch.ones(3, dtype=torch.float64), 2.0 * torch.eye(3, dtype=torch.float64)
    found = form(filtered(mean, P, steps))
    assert_equals_joint(found, mean, P, steps, 1e-10)


@pytest.mark.parametrize(
    ("count", "chunk"), [(1, None), (2, 1), (7, 3), (30, None), (31, 31), (300, None)]
)
def test_parallel_form_equals_the_recursion(count: int, chunk: int | None) -> None:
    steps = random_steps(count, (2,), count, 4, 3)
    mean = torch.ones(2, 4, dtype=torch.float64)
    forward = filtered(mean, torch.eye(4, dtype=torch.float64).expand(2, 4, 4), steps)
    for a, b in zip(smooth_in_turn(forward), smooth_in_parallel(forward, chunk), strict=True):
        torch.testing.assert_close(a, b, atol=1e-12, rtol=1e-11)


def car(count: int, seed: int, q_bias: float, p_known: float) -> tuple[Tensor, Tensor, LinearSteps]:
    """Position, azimuth, gyro bias, a parameter known to ``p_known`` and one that only stays.

    Scales and correlations are those of an outage: 40 steps see nothing.
    """
    g = torch.Generator().manual_seed(seed)
    F = torch.eye(5, dtype=torch.float64).repeat(count, 1, 1)
    F[:, 0, 1], F[:, 1, 2], F[:, 0, 2], F[:, 0, 3], F[:, 0, 4] = 15.0, 1.0, 7.5, 15.0, 1.0
    Q = torch.diag(torch.tensor([0.0, 1e-9, q_bias, 0.0, 0.0], dtype=torch.float64))
    H = torch.zeros(count, 1, 5, dtype=torch.float64)
    H[:, 0, 0] = 1.0
    H[count // 2 - 20 : count // 2 + 20] = 0.0
    y = 3.0 * torch.randn(count, 1, generator=g, dtype=torch.float64)
    steps = LinearSteps(
        F,
        torch.zeros(count, 5, dtype=torch.float64),
        Q.expand(count, 5, 5),
        H,
        torch.full((count, 1), 9.0, dtype=torch.float64),
        y,
    )
    P = torch.diag(torch.tensor([9.0, 1e-3, 1e-6, p_known, 1e-2], dtype=torch.float64))
    return torch.zeros(5, dtype=torch.float64), P, steps


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("q_bias", [0.0, 1e-14])
@pytest.mark.parametrize("p_known", [0.0, 1e-20, 1e-4])
def test_states_without_noise_or_variance_do_no_harm(form, q_bias: float, p_known: float) -> None:
    mean, P, steps = car(80, 1, q_bias, p_known)
    found = form(filtered(mean, P, steps))
    m, spread = joint_gaussian(mean, P, steps)
    sigma = np.sqrt(np.diagonal(spread).clip(1e-30))
    np.testing.assert_allclose(found.mean.numpy().ravel() / sigma, m / sigma, atol=1e-4)
    for k in range(81):
        here = slice(5 * k, 5 * k + 5)
        unit = np.outer(sigma[here], sigma[here])
        np.testing.assert_allclose(
            found.covariance[k].numpy() / unit, spread[here, here] / unit, atol=1e-4
        )


@pytest.mark.parametrize("form", FORMS)
def test_covariances_stay_positive_and_below_the_filters(form) -> None:
    """A quarter of an hour of a badly scaled system without noise on most states."""
    mean, P, steps = car(900, 2, 0.0, 0.0)
    forward = filtered(mean, P, steps)
    found = form(forward)
    scale = forward.covariance.diagonal(dim1=-2, dim2=-1).clamp(min=1e-30).sqrt()
    unit = scale.unsqueeze(-1) * scale.unsqueeze(-2)
    assert bool(torch.isfinite(found.mean).all())
    assert float(torch.linalg.eigvalsh(found.covariance / unit).min()) > -1e-12
    gained = torch.linalg.eigvalsh((forward.covariance - found.covariance) / unit)
    assert float(gained.min()) > -1e-7


def test_gain_of_a_singular_prediction_is_the_pseudo_inverse() -> None:
    g = torch.Generator().manual_seed(4)
    root = torch.randn(4, 2, generator=g, dtype=torch.float64)
    P, F = root @ root.T, torch.randn(4, 4, generator=g, dtype=torch.float64)
    found = smoother_gain(P, F, torch.zeros(4, 4, dtype=torch.float64))
    predicted = (F @ P @ F.T).numpy()
    expected = P.numpy() @ F.T.numpy() @ np.linalg.pinv(predicted, rcond=1e-9)
    # what is asked of a gain: its action on what can happen
    np.testing.assert_allclose(found.numpy() @ predicted, expected @ predicted, atol=1e-9)
    assert float(found.abs().max()) < 10.0 * np.abs(expected).max()


@pytest.mark.parametrize("form", FORMS)
def test_gradient_is_that_of_finite_differences(form) -> None:
    steps = random_steps(3, (), 7, 2, 1)
    mean, P = torch.zeros(2, dtype=torch.float64), torch.eye(2, dtype=torch.float64)

    def first(transition: Tensor, noise: Tensor, measurement: Tensor) -> tuple[Tensor, Tensor]:
        q = noise @ noise.transpose(-1, -2)
        moved = steps._replace(transition=transition, noise=q, measurement=measurement)
        done = form(filtered(mean, P, moved))
        return done.mean, done.covariance

    inputs = (steps.transition, steps.noise, steps.measurement)
    assert torch.autograd.gradcheck(first, tuple(x.clone().requires_grad_() for x in inputs))


def test_smoothing_tells_more_than_filtering() -> None:
    """In the middle of the gap both ends are known: the position is far better than filtered."""
    mean, P, steps = car(200, 5, 1e-12, 1e-4)
    forward = filtered(mean, P, steps)
    found = smooth_in_turn(forward)
    before = forward.covariance[120, 0, 0].sqrt()
    assert float(found.covariance[100:120, 0, 0].max().sqrt()) < 0.3 * float(before)
