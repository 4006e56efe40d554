"""The unscented filter of a RISS car against a textbook in NumPy and the extended filter."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between
from navlearn.fusion.error_state import initial_belief, position_difference
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.noise_options import InitialOptions, NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.mechanization.options import RissOptions
from navlearn.states import NavState

POINTS = UnscentedOptions()


def run(options, d, method="exact", **changes):
    with torch.no_grad():
        belief = initial_belief(options, d.start)._replace(**changes)
        return riss_filter(options)(belief, d.samples, d.fixes, d.timing, method=method)


def apart(a, b):
    """Largest distance between two trajectories or states, m."""
    return max(float(x.abs().max()) for x in enu_between(*a[:3], *b[:3]))


def relative(P, other):
    sigma = other.diagonal(dim1=-2, dim2=-1).sqrt()
    return float(((P - other).abs() / (sigma[..., None] * sigma[..., None, :])).max())


VARIANTS = {
    "bias_scale": EkfOptions(),
    "2D": EkfOptions(mechanization=RissOptions(dimensions=2)),
    "augmented": EkfOptions(
        gyro_terms=("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y"),
        speed_terms=("scale", "delay", "offset"),
    ),
    "returning": EkfOptions(correlation_time=120.0),
    "course": EkfOptions(velocity=False, course=True),
    "arm": EkfOptions(lever_arm=(0.6, -1.1, 1.4)),
    "bias_free": EkfOptions(model="bias_free"),
    "shen2010": EkfOptions(model="shen2010"),
    "shen2010_full": EkfOptions(model="shen2010_full"),
}


def unscented(options, points=POINTS, **changes):
    return replace(options, unscented=points, **changes)


@pytest.mark.parametrize("name", VARIANTS)
def test_it_goes_with_the_extended_filter_where_little_is_bent(make_drive, name):
    """All models and kinds of measurement, late fixes among them."""
    d = make_drive(seconds=8, rate=5, batch=2)
    d = d._replace(timing=d.timing._replace(delay=d.timing.delay + 0.03))
    extended = run(VARIANTS[name], d)
    exact = run(unscented(VARIANTS[name], UnscentedOptions(alpha=0.1)), d)
    assert (exact.method, exact.passes) == ("exact", 1)
    if name == "shen2010":
        # the points know no F: as they move, none of the terms that are not printed is missing
        extended = run(VARIANTS["shen2010_full"], d)
    assert apart(exact.trajectory, extended.trajectory) < 0.05
    assert relative(exact.belief.covariance[:, -1], extended.belief.covariance[:, -1]) < 0.03
    for a, b in zip(exact[:2], extended[:2], strict=True):
        assert torch.equal(a, b)
    assert exact.innovation.shape == extended.innovation.shape
    assert torch.equal(torch.isnan(exact.nis), torch.isnan(extended.nis))


@pytest.mark.parametrize("name", ["augmented", "course", "shen2010_full"])
def test_forms_differ_by_when_points_are_drawn(make_drive, name):
    """The oracle draws points anew at each sample: within a block of a second that is millimetres,
    and as little for the narrowest points."""
    d = make_drive(seconds=5, rate=5)
    for alpha in (1.0, 1e-4):
        options = unscented(VARIANTS[name], UnscentedOptions(alpha=alpha))
        exact, turn = run(options, d), run(options, d, "sequential")
        assert turn.method == "sequential"
        assert apart(exact.trajectory, turn.trajectory) < 2e-3
        assert relative(exact.belief.covariance, turn.belief.covariance) < 2e-3


def order_of(make_drive, points):
    """Gap to the extended filter as all deviations and noise shrink together."""
    gap = []
    for size in (0.25, 0.125, 0.0625, 0.03125):
        d = make_drive(
            seconds=8,
            rate=5,
            bias=0.002 * size,
            scale=0.02 * size,
            pitch_bias=0.01 * size,
            gyro_random_walk=2e-4 * size,
            position_sigma=size,
            velocity_sigma=0.1 * size,
        )
        plain, first = NoiseOptions(), InitialOptions()
        noise = {
            name: size * getattr(plain, name)
            for name in plain.__dataclass_fields__
            if not name.endswith("inflation")
        }
        options = EkfOptions(
            noise=NoiseOptions(**noise),
            initial=InitialOptions(
                position=first.position * size,
                height=first.height * size,
                azimuth=first.azimuth * size,
                pitch_bias=first.pitch_bias * size,
                gyro={"bias": first.gyro["bias"] * size},
                speed={"scale": first.speed["scale"] * size},
            ),
            gate=GateOptions(probability=1.0),
        )
        a, b = run(unscented(options, points), d), run(options, d)
        gap.append(apart(a.belief.state, b.belief.state))
    return np.diff(np.log(gap)) / math.log(0.5), gap


@pytest.mark.parametrize("alpha", [1.0, 1e-2])
def test_it_is_the_extended_filter_to_first_order(make_drive, alpha):
    """The gap is of second order in the size of all errors."""
    order, gap = order_of(make_drive, UnscentedOptions(alpha=alpha))
    assert gap[0] > 5e-5
    assert bool((np.abs(order - 2.0) < 0.35).all()), (order, gap)


FLAT = EkfOptions(
    mechanization=RissOptions(dimensions=2, earth_rate=False),
    zero_yaw_rate=False,
    zero_speed=False,
    gate=GateOptions(probability=1.0),
)


def in_numpy(options, points, d, vehicle):
    """[Ghouneem2024] (14)–(31) with total states in metres, radians and doubles, by loops.

    East, north, up, azimuth, gyro bias, odometer scale; the azimuth's mean by sines and cosines.
    """
    n, rate = 6, len(d.samples.dt[0]) // len(d.timing.index[0])
    square = 3.0 / (n + points.kappa) if points.alpha is None else points.alpha**2
    lam = square * (n + points.kappa) - n
    w = np.full(2 * n + 1, 0.5 / (n + lam))
    w[0] = lam / (n + lam)
    wc = w.copy()
    wc[0] += 1.0 - square + points.beta
    noise = vehicle.noise
    R = np.diag(
        [(1.5 * 1.0) ** 2 + float(noise.position_floor) ** 2] * 2
        + [(1.5 * 1.0) ** 2 + float(noise.height_floor) ** 2]
        + [0.1**2 + float(noise.velocity_floor) ** 2 + float(noise.speed_noise) ** 2] * 2
    )
    told = torch.stack(enu_between(*d.fixes[:3], *(x.unsqueeze(-1) for x in d.start[:3])), -1)
    told = torch.cat((told, torch.stack((d.fixes.v_e, d.fixes.v_n), -1)), -1)[0].numpy()
    speed, gyro, dt = (x[0].numpy() for x in (d.samples.speed, d.samples.yaw_rate, d.samples.dt))
    sigma = initial_belief(options, d.start).covariance[0].diagonal().sqrt().numpy()
    x, P = np.array([0.0, 0.0, 0.0, float(d.start.azimuth), 0.0, 0.0]), np.diag(sigma**2)

    def drawn(x, P):
        root = np.sqrt(n + lam) * np.linalg.cholesky(P)
        return np.vstack([x, x + root.T, x - root.T])

    def averaged(X):
        mean = w @ X
        s, c = w @ np.sin(X[:, 3]), w @ np.cos(X[:, 3])
        mean[3] = X[0, 3] + np.angle(np.exp(1j * (np.arctan2(s, c) - X[0, 3])))
        away = X - mean
        return mean, away

    means, spreads = [], []
    for k in range(len(dt)):
        X = drawn(x, P)
        v, turn = speed[k] / (1.0 + X[:, 5]), -(gyro[k] - X[:, 4]) * dt[k]
        middle = X[:, 3] + 0.5 * turn
        X[:, 0] += v * np.sin(middle) * dt[k]
        X[:, 1] += v * np.cos(middle) * dt[k]
        X[:, 3] += turn
        x, away = averaged(X)
        q_azimuth = float(noise.gyro_random_walk) ** 2 + (float(noise.turn_noise) * gyro[k]) ** 2
        walk = [float(noise.position_walk)] * 2 + [float(noise.hill_walk)]
        q = [s**2 for s in walk] + [q_azimuth, float(noise.gyro_bias_walk) ** 2]
        q.append(float(noise.speed_scale_walk) ** 2)
        P = away.T @ (wc[:, None] * away) + np.diag(q) * dt[k]
        if (k + 1) % rate == 0:
            X = drawn(x, P)
            push = vehicle_push(speed, dt, k)
            v = (speed[k] + 0.5 * dt[k] * push) / (1.0 + X[:, 5])
            east, north = v * np.sin(X[:, 3]), v * np.cos(X[:, 3])
            Z = np.column_stack([X[:, :3], east, north])
            z = w @ Z
            dz, dx = Z - z, X - x
            K = (dx.T @ (wc[:, None] * dz)) @ np.linalg.inv(dz.T @ (wc[:, None] * dz) + R)
            P = P - K @ (dz.T @ (wc[:, None] * dz) + R) @ K.T
            x = x + K @ (told[k // rate] - z)
            means.append(x)
            spreads.append(P)
    return np.array(means), np.array(spreads)


def vehicle_push(speed, dt, k):
    """Acceleration of the odometer over two spans of 0.2 s, as the filter differences it."""
    lag = max(1, round(0.2 / dt[0]))
    if k + 1 < 2 * lag:
        return 0.0
    late, early = speed[k + 1 - lag : k + 1], speed[k + 1 - 2 * lag : k + 1 - lag]
    return (late.mean() - early.mean()) / (lag * dt[0])


@pytest.mark.parametrize("points", [POINTS, UnscentedOptions(alpha=0.3, beta=1.0, kappa=2.0)])
def test_it_is_the_textbooks_filter(make_drive, points):
    """A second implementation, of total states and with weights at their word; the first runs on
    deviations with pairs of points. What is left is the Earth's curvature, and what the noise of an
    azimuth moves a position within a sample."""
    d = make_drive(seconds=8, rate=5)
    still = torch.zeros_like(d.samples.stationary)
    d = d._replace(samples=d.samples._replace(stationary=still))
    options = unscented(FLAT, points)
    found = run(options, d, "sequential")
    means, spreads = in_numpy(options, points, d, LooselyCoupledUkf(options))
    at = NavState(*(x[0] for x in found.belief.state))
    place = position_difference(at, NavState(*(x.expand_as(at.lat) for x in d.start)))
    np.testing.assert_allclose(place.numpy(), means[:, :3], rtol=0.0, atol=4e-3)
    np.testing.assert_allclose(at.azimuth.numpy(), means[:, 3], rtol=0.0, atol=2e-4)
    np.testing.assert_allclose(found.belief.sensor[0].numpy(), means[:, 4:], rtol=0.0, atol=1e-4)
    P = torch.from_numpy(spreads)
    assert relative(found.belief.covariance[0], P) < 5e-3
