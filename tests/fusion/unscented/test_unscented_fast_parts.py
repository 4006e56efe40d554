"""What the fast unscented form is made of: sums over samples, whitened rows, gradients."""

import math

import pytest
import torch

from navlearn.filters.ekf import update
from navlearn.filters.square_root import root_of
from navlearn.filters.unscented import UnscentedOptions, sigma_points
from navlearn.filters.whitening import whitened
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.noise_options import InitialOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.unscented import carry as carrying
from navlearn.fusion.unscented.carry import plain_carry, riss_carry
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.mechanization.options import RissOptions

AUGMENTED = {
    "gyro_terms": ("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y"),
    "speed_terms": ("delay", "scale", "offset"),
}
VARIANTS = {
    "default": EkfOptions(),
    "augmented": EkfOptions(**AUGMENTED),
    "gauss_markov": EkfOptions(correlation_time=20.0),
    "flat": EkfOptions(mechanization=RissOptions(dimensions=2), **AUGMENTED),
    "bias_free": EkfOptions(model="bias_free"),
    "no_tilt": EkfOptions(mechanization=RissOptions(tilt_compensation=False)),
    "no_pitch_bias": EkfOptions(pitch_bias=False),
    "no_odometer_errors": EkfOptions(speed_terms=()),
    "still_earth": EkfOptions(mechanization=RissOptions(earth_rate=False)),
}


def carried(options, d, carry_of):
    """Return images of sigma points about the filter's own beliefs, and the central points."""
    ukf = LooselyCoupledUkf(options)
    with torch.no_grad():
        belief = initial_belief(options, d.start)
        after = ukf(belief, d.samples, d.fixes, d.timing).belief
        begin = starts_of_blocks(belief, after)
        blocks = ukf.all_blocks(ukf.laid_out(d.samples, d.fixes, d.timing))
        points = sigma_points(root_of(begin.covariance), ukf.weights)
        return carry_of(ukf)(begin, points, blocks)


@pytest.mark.parametrize("name", VARIANTS)
def test_sums_over_samples_carry_points_as_samples_do(make_drive, monkeypatch, name):
    monkeypatch.setattr(carrying, "LEFT", math.inf)
    d = make_drive(seconds=40, batch=2)
    samples = d.samples._replace(
        f_x=0.5 * torch.sin(d.samples.dt.cumsum(-1)), f_y=0.3 * torch.cos(d.samples.dt.cumsum(-1))
    )
    d = d._replace(samples=samples)
    centre, images = carried(VARIANTS[name], d, riss_carry)
    plain_centre, plain = carried(VARIANTS[name], d, plain_carry)
    assert float((images - plain)[..., :3].abs().max()) < 2e-5
    assert float((images - plain)[..., 3:].abs().max()) < 2e-6
    torch.testing.assert_close(centre.belief.state.lat, plain_centre.belief.state.lat)
    torch.testing.assert_close(centre.transition, plain_centre.transition)
    torch.testing.assert_close(centre.noise, plain_centre.noise)


def test_points_wide_apart_are_carried_over_the_samples(make_drive, monkeypatch):
    initial = InitialOptions(gyro={"bias": 0.05}, pitch_bias=0.2)
    options = EkfOptions(initial=initial, unscented=UnscentedOptions(alpha=1.0))
    d = make_drive(seconds=20, seed=5)
    _, plain = carried(options, d, plain_carry)
    _, images = carried(options, d, riss_carry)
    assert float((images - plain)[..., :3].abs().max()) < 2e-5
    monkeypatch.setattr(carrying, "LEFT", math.inf)
    _, told_by_sums = carried(options, d, riss_carry)
    assert float((told_by_sums - plain)[..., :3].abs().max()) > 1e-3


@pytest.mark.parametrize(
    ("carry_of", "size"), [(plain_carry, "AT_ONCE"), (riss_carry, "AT_ONCE_IN_SUMS")]
)
def test_blocks_may_be_carried_some_at_a_time(make_drive, monkeypatch, carry_of, size):
    d = make_drive(seconds=20, batch=2)
    centre, at_once = carried(EkfOptions(), d, carry_of)
    monkeypatch.setattr(carrying, size, 3000)
    same, parts = carried(EkfOptions(), d, carry_of)
    torch.testing.assert_close(parts, at_once, rtol=0.0, atol=1e-12)
    torch.testing.assert_close(same, centre)


def test_whitened_rows_tell_the_same():
    g = torch.Generator().manual_seed(0)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    root, noise = normal(4, 5, 5), normal(4, 3, 3) * torch.tensor([1.0, 1e-4, 1e3])[:, None]
    P, R = root @ root.mT, noise @ noise.mT
    H, y = normal(4, 3, 5) * torch.tensor([1.0, 1e-4, 1e3])[:, None], normal(4, 3)
    S = H @ P @ H.mT + R
    gain = P @ H.mT @ torch.linalg.inv(S)
    white, told = whitened(H, R, y)
    found = update(P, white, torch.ones_like(told), told)
    torch.testing.assert_close(
        found.correction, (gain @ y[..., None])[..., 0], rtol=1e-8, atol=1e-8
    )
    torch.testing.assert_close(found.covariance, P - gain @ H @ P, rtol=1e-7, atol=1e-7)


def gradients(d, method, *, sigma=None, off=0.0):
    """Return gradients of some of all that a run tells, by noise, gyro, odometer and start."""
    options = EkfOptions(unscented=UnscentedOptions(alpha=1.0))
    ukf = LooselyCoupledUkf(options).requires_grad_()
    rate, speed = (x.clone().requires_grad_() for x in (d.samples.yaw_rate, d.samples.speed))
    belief = initial_belief(
        ukf.options, d.start, sigmas={} if sigma is None else {"azimuth": sigma}
    )
    azimuth = (belief.state.azimuth + off).requires_grad_()
    belief = belief._replace(state=belief.state._replace(azimuth=azimuth))
    samples = d.samples._replace(yaw_rate=rate, speed=speed)
    h = ukf(belief, samples, d.fixes, d.timing, method=method)
    assert h.method == method
    variance = h.belief.covariance.diagonal(dim1=-2, dim2=-1)
    loss = torch.nan_to_num(h.nis).sum() + 1e9 * (h.trajectory.lat - 0.77).square().sum()
    loss = loss + h.trajectory.azimuth.square().sum() + 0.1 * variance.log().sum()
    return torch.autograd.grad(loss, [ukf.log_noise, rate, speed, azimuth])


@pytest.mark.parametrize(("sigma", "off"), [(None, 0.0), (0.8, 0.5), (2.0, 2.5)])
def test_gradients_are_those_of_the_loop(make_drive, sigma, off):
    d = make_drive(seconds=30, rate=10, batch=2, seed=2)
    exact, at_once = (gradients(d, m, sigma=sigma, off=off) for m in ("exact", "fast"))
    for found, expected in zip(at_once, exact, strict=True):
        assert float((found - expected).abs().max() / expected.abs().max()) < 2e-3


@pytest.mark.parametrize("method", ["exact", "fast"])
def test_gradcheck_by_noise_on_a_short_drive(make_drive, method):
    d = make_drive(seconds=8, rate=5)
    ukf = LooselyCoupledUkf()
    at = ukf.log_noise.detach().clone()
    names = ("gyro_random_walk", "position_walk", "position_floor", "speed_noise", "turn_noise")
    for name in names:
        k = EkfNoise._fields.index(name)

        def loss(value, k=k):
            where = torch.arange(len(at)) == k
            log_noise = torch.where(where, value, at)
            h = torch.func.functional_call(
                ukf,
                {"log_noise": log_noise},
                (initial_belief(ukf.options, d.start), d.samples, d.fixes, d.timing),
                {"method": method},
            )
            variance = h.belief.covariance.diagonal(dim1=-2, dim2=-1)
            return torch.nan_to_num(h.nis).sum() + variance.log().sum()

        value = at[k].clone().requires_grad_()
        (slope,) = torch.autograd.grad(loss(value), value)
        with torch.no_grad():
            step = 1e-4
            numeric = (loss(value + step) - loss(value - step)) / (2.0 * step)
        assert float((slope - numeric).abs()) < 1e-3 * float(numeric.abs()) + 1e-4
