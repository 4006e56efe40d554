"""Sigma points against the textbook's sums in NumPy, filterpy, and moments in closed form."""

import math

import numpy as np
import pytest
import torch

from navlearn.errors import ConfigError
from navlearn.filters.regression import regressed
from navlearn.filters.square_root import root_of
from navlearn.filters.unscented import (
    UnscentedOptions,
    image_moments,
    sigma_points,
    sigma_weights,
)

SPREADS = [
    UnscentedOptions(),
    UnscentedOptions(alpha=1.0),
    UnscentedOptions(alpha=0.5, beta=2.0, kappa=1.0),
    UnscentedOptions(alpha=1.0, beta=0.0, kappa=0.0),
    UnscentedOptions(alpha=1.3, beta=0.5, kappa=3.0),
    UnscentedOptions(alpha=1e-2, beta=2.0, kappa=0.0),
]


def spread_of(options, n):
    """α; None stands for points three deviations out in the square."""
    return math.sqrt(3.0 / (n + options.kappa)) if options.alpha is None else options.alpha


def random_root(seed, n, batch=()):
    g = torch.Generator().manual_seed(seed)
    return root_of(_square(torch.randn(*batch, n, n, generator=g, dtype=torch.float64)))


def _square(root):
    return root @ root.transpose(-1, -2)


def curved(x):
    a, b, c, d = x.unbind(-1)
    return torch.stack((a * b + c, torch.sin(d) + a, 0.3 * c**2 - b), -1)


def textbook(options, root, function, mean):
    """[Ghouneem2024] (14)–(24) with the sum that is meant, as loops over columns."""
    n = root.shape[-1]
    alpha = spread_of(options, n)
    scale = alpha**2 * (n + options.kappa) - n
    spread = math.sqrt(n + scale)
    points = [mean]
    points += [mean + spread * root[:, j] for j in range(n)]
    points += [mean - spread * root[:, j] for j in range(n)]
    in_mean = np.full(2 * n + 1, 0.5 / (n + scale))
    in_mean[0] = scale / (n + scale)
    in_square = in_mean.copy()
    in_square[0] += 1.0 - alpha**2 + options.beta
    images = [function(torch.from_numpy(p)).numpy() for p in points]
    centre = sum(w * y for w, y in zip(in_mean, images, strict=True))
    square = sum(
        w * np.outer(y - centre, y - centre) for w, y in zip(in_square, images, strict=True)
    )
    cross = sum(
        w * np.outer(p - mean, y - centre)
        for w, p, y in zip(in_square, points, images, strict=True)
    )
    return centre, square, cross


def moments_of(options, root, function, mean):
    weights = sigma_weights(options, root.shape[-1])
    images = function(mean + sigma_points(root, weights))
    found = image_moments(images - images[..., :1, :], weights)
    return images[..., 0, :] + found.shift, found


@pytest.mark.parametrize("options", SPREADS)
def test_moments_are_the_textbooks(options):
    root, mean = random_root(1, 4), torch.tensor([0.3, -1.0, 2.0, 0.5], dtype=torch.float64)
    centre, square, cross = textbook(options, root.numpy(), curved, mean.numpy())
    found, moments = moments_of(options, root, curved, mean)
    # what the textbook's sums keep beside a weight as large as 1/α²
    close = {"rtol": 0.0, "atol": 1e-13 / min(1.0, spread_of(options, 4) ** 2)}
    np.testing.assert_allclose(found.numpy(), centre, **close)
    np.testing.assert_allclose(moments.covariance.numpy(), square, **close)
    np.testing.assert_allclose((root @ moments.slope.T).numpy(), cross, **close)


def test_weights_are_those_of_filterpy():
    kalman = pytest.importorskip("filterpy.kalman", reason="pip install filterpy")
    for options in SPREADS:
        peer = kalman.MerweScaledSigmaPoints(5, spread_of(options, 5), options.beta, options.kappa)
        ours = sigma_weights(options, 5)
        assert ours.mean == pytest.approx(peer.Wm[0], rel=1e-12, abs=1e-12)
        assert ours.covariance == pytest.approx(peer.Wc[0], rel=1e-12)
        assert ours.each == pytest.approx(peer.Wm[1], rel=1e-12)
        root = random_root(2, 5)
        drawn = peer.sigma_points(np.zeros(5), _square(root).numpy())
        np.testing.assert_allclose(sigma_points(root, ours).numpy(), drawn, atol=1e-12)


@pytest.mark.parametrize("alpha", [1.0, 1e-1, 1e-2, 1e-3, 1e-4])
def test_the_mean_of_a_quadratic_is_exact_at_every_spread(alpha):
    """E[xᵀAx] = tr(AP) + mᵀAm, far from the origin; naive sums lose all digits at 1e-4."""
    g = torch.Generator().manual_seed(3)
    A = _square(torch.randn(5, 5, generator=g, dtype=torch.float64))
    root, mean = random_root(4, 5), 10.0 * torch.ones(5, dtype=torch.float64)

    def apart(d):
        """Image minus the central one, as a vehicle tells it: without the common part."""
        return (2.0 * (d @ A @ mean) + ((d @ A) * d).sum(-1)).unsqueeze(-1)

    weights = sigma_weights(UnscentedOptions(alpha=alpha), 5)
    found = image_moments(apart(sigma_points(root, weights)), weights)
    exact = float(torch.trace(A @ _square(root)))
    assert float(found.shift) == pytest.approx(exact, rel=1e-15 / alpha**2 * 10 + 1e-12)


@pytest.mark.parametrize("alpha", [1.0, 1e-2, 1e-4])
def test_the_variance_of_a_square_is_exact_for_one_state(alpha):
    """Var[x²] = 2 P² for a normal variable: what β = 2 is for."""
    root = torch.tensor([[0.7]], dtype=torch.float64)
    weights = sigma_weights(UnscentedOptions(alpha=alpha), 1)
    found = image_moments(sigma_points(root, weights) ** 2, weights)
    assert float(found.shift) == pytest.approx(0.49, rel=1e-12)
    assert float(found.covariance) == pytest.approx(2.0 * 0.49**2, rel=1e-12)


def test_points_lie_at_the_root_of_three_whatever_there_is_to_estimate():
    for size, kappa in ((1, 0.0), (7, 0.0), (21, 2.0)):
        weights = sigma_weights(UnscentedOptions(kappa=kappa), size)
        assert weights.gamma == pytest.approx(math.sqrt(3.0), rel=1e-14)
        told = sigma_weights(
            UnscentedOptions(alpha=math.sqrt(3.0 / (size + kappa)), kappa=kappa), size
        )
        assert weights == pytest.approx(told, rel=1e-13)
    # the fourth moment of a normal: E[x⁴] = 3
    weights = sigma_weights(UnscentedOptions(), 5)
    points = sigma_points(torch.eye(5, dtype=torch.float64), weights)
    fourth = weights.each * (points**4).sum(0)
    torch.testing.assert_close(fourth, torch.full((5,), 3.0, dtype=torch.float64))


def test_polar_coordinates_have_the_mean_in_closed_form():
    """E[r (cos θ, sin θ)] = μ (cos θ₀, sin θ₀) e^(−σ²/2); with γ² = 3 right to fourth order."""
    root = torch.diag(torch.tensor([0.02, 0.2], dtype=torch.float64))
    mean = torch.tensor([1.0, math.pi / 2], dtype=torch.float64)

    def cartesian(x):
        return torch.stack((x[..., 0] * torch.cos(x[..., 1]), x[..., 0] * torch.sin(x[..., 1])), -1)

    exact = math.exp(-0.5 * 0.2**2)
    linear = abs(1.0 - exact)
    error = {}
    for alpha in (1e-4, 1.0, math.sqrt(1.5)):
        found, _ = moments_of(UnscentedOptions(alpha=alpha), root, cartesian, mean)
        assert abs(float(found[0])) < 1e-7
        error[alpha] = abs(float(found[1]) - exact)
        assert error[alpha] < 0.02 * linear
    assert error[math.sqrt(1.5)] < 0.01 * error[1e-4]
    assert error[math.sqrt(1.5)] < 1e-6


@pytest.mark.parametrize("options", [*SPREADS, UnscentedOptions(alpha=1e-4)])
def test_what_no_line_explains_is_never_negative(options):
    """The central weight of a covariance may be −1e8; Ω is a product of a root all the same."""
    g = torch.Generator().manual_seed(5)
    weights = sigma_weights(options, 3)
    images = torch.randn(50, 7, 4, generator=g, dtype=torch.float64)
    images[:, 0] = 0.0
    found = image_moments(images, weights)
    # by the textbook's sums, W₀ᶜ at its word
    mean = weights.each * images[:, 1:].sum(1)
    away = images - mean.unsqueeze(1)
    square = weights.each * (away[:, 1:].transpose(1, 2) @ away[:, 1:])
    square = square + weights.covariance * mean.unsqueeze(-1) * mean.unsqueeze(-2)
    rest = square - found.slope @ found.slope.transpose(1, 2)
    scale = float(square.abs().amax())
    torch.testing.assert_close(found.unexplained, rest, rtol=0.0, atol=1e-7 * scale)
    assert float(torch.linalg.eigvalsh(found.unexplained).amin()) > -1e-13 * scale


def test_a_line_is_regressed_as_it_is_and_leaves_nothing():
    root, weights = random_root(6, 4, (3,)), sigma_weights(UnscentedOptions(), 4)
    A = torch.randn(3, 2, 4, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    images = sigma_points(root, weights) @ A.transpose(-1, -2)
    found = regressed(root, image_moments(images, weights), torch.zeros_like(A))
    torch.testing.assert_close(found.slope, A, rtol=0.0, atol=1e-12)
    assert float(found.shift.abs().amax()) < 1e-14
    assert float(found.unexplained.abs().amax()) < 1e-28


def test_the_regression_is_that_of_the_moments():
    """Φ = P_yx P⁻¹ and Ω = P_yy − Φ P Φᵀ, by the textbook's moments."""
    options, root = UnscentedOptions(alpha=0.5), random_root(8, 4)
    mean = torch.tensor([0.3, -1.0, 2.0, 0.5], dtype=torch.float64)
    _, square, cross = textbook(options, root.numpy(), curved, mean.numpy())
    _, moments = moments_of(options, root, curved, mean)
    found = regressed(root, moments, torch.zeros(3, 4, dtype=torch.float64))
    P = _square(root).numpy()
    slope = cross.T @ np.linalg.inv(P)
    np.testing.assert_allclose(found.slope.numpy(), slope, atol=1e-11)
    np.testing.assert_allclose(found.unexplained.numpy(), square - slope @ P @ slope.T, atol=1e-11)


def test_a_derivative_answers_for_states_that_have_no_variance():
    root = torch.tensor([[1.0, 0.0], [0.0, 0.0]], dtype=torch.float64)
    weights = sigma_weights(UnscentedOptions(), 2)
    A = torch.tensor([[2.0, 5.0]], dtype=torch.float64)
    images = sigma_points(root, weights) @ A.T
    found = regressed(root, image_moments(images, weights), A + torch.tensor([[9.0, 0.0]]))
    torch.testing.assert_close(found.slope, A)


def test_the_mean_of_angles_is_that_on_the_circle():
    """Differences from the centre do not see the cut at ±180°."""
    root = torch.diag(torch.tensor([0.1], dtype=torch.float64))
    weights = sigma_weights(UnscentedOptions(), 1)
    found = {}
    for centre in (math.pi, 0.3):
        azimuth = centre + sigma_points(root, weights)[..., 0]
        away = azimuth - azimuth[0] + 0.4 * (azimuth - azimuth[0]) ** 2
        found[centre] = float(image_moments(away.unsqueeze(-1), weights).shift)
        # by sines and cosines, of the images wrapped to ±180°
        share = torch.tensor([weights.mean, weights.each, weights.each], dtype=torch.float64)
        seen = torch.remainder(azimuth[0] + away + math.pi, 2.0 * math.pi) - math.pi
        s, c = (share * torch.sin(seen)).sum(), (share * torch.cos(seen)).sum()
        around = float(torch.atan2(s, c)) - centre
        around -= 2.0 * math.pi * round(around / (2.0 * math.pi))
        assert found[centre] == pytest.approx(around, abs=2e-4)
    assert found[math.pi] == pytest.approx(found[0.3], abs=1e-15)


@pytest.mark.parametrize(
    "values",
    [{"alpha": 0.0}, {"alpha": math.nan}, {"alpha": 11.0}, {"beta": -1.0}, {"kappa": math.inf}],
)
def test_spreads_without_points_are_refused(values):
    with pytest.raises(ConfigError, match=f"UnscentedOptions.{next(iter(values))}"):
        UnscentedOptions(**values)
