"""Rows of unit variance against the whole covariance written out, and what fixes told."""

import math

import numpy as np
import pytest
import torch

from navlearn.errors import ConfigError, FitError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.azimuth_regression import (
    AzimuthCurve,
    AzimuthNoise,
    azimuth_curve,
    azimuth_told,
    sums_over_blocks,
    whitened_rows,
)
from navlearn.learning.weighted_ridge import solve_ridge
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.options import RissOptions
from navlearn.navigator import Navigator, NavigatorOptions, NavigatorRun

NOISE = AzimuthNoise(
    gyro_random_walk=3e-4, turn_noise=0.01, gyro_bias_walk=2e-5, gyro_bias=2e-3, rest=4e-4
)
TERMS = 3


def curve(rng: np.random.Generator, blocks: int = 80) -> AzimuthCurve:
    """A drive of one-second blocks: every seventh has no fix, some stand still."""
    rest = np.zeros(blocks)
    rest[30:36] = 1.0
    rest[60] = 0.6
    moving = np.where(rest > 0.9, 0.0, 1.0 - rest)
    told = (np.arange(blocks) % 7 != 3) & (rest == 0.0)
    rates = rng.standard_normal((blocks, TERMS)) * [0.2, 0.1, 1.0]
    turned = -np.cumsum(rates * moving[:, None], 0)
    turned -= turned[0]
    variance = np.where(told, rng.uniform(1e-5, 1e-4, blocks), np.inf)
    return AzimuthCurve(
        raw=torch.zeros(blocks, dtype=torch.float64),
        error=torch.tensor(np.where(told, rng.standard_normal(blocks), np.nan)),
        variance=torch.tensor(variance),
        turned=torch.tensor(turned),
        moving=torch.tensor(moving),
        duration=torch.ones(blocks, dtype=torch.float64),
        turning=torch.tensor(rng.uniform(0.0, 0.1, blocks) * moving),
        rest=torch.tensor(rest),
        rest_rate=torch.tensor(rng.standard_normal(blocks) * 1e-3),
        rest_terms=torch.tensor(rng.standard_normal((blocks, TERMS)) * [0.0, 0.0, 1.0]),
        end=torch.arange(blocks) * 10 + 9,
    )


def written_out(one: AzimuthCurve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns, target and the whole covariance of what was measured, without any recursion.

    States at all blocks are linear in the start and the noise of each step; the walk of the bias
    within a step leans on the angle by a half and a third.
    """
    blocks = len(one.moving)
    tau, still = one.moving.numpy(), one.rest.numpy()
    effect = np.zeros((blocks, 2, 2 + 2 * blocks))
    effect[0, 0, 0] = effect[0, 1, 1] = 1.0
    covariance = np.zeros((2 + 2 * blocks,) * 2)
    covariance[0, 0], covariance[1, 1] = 100.0, NOISE.gyro_bias**2
    for k in range(1, blocks):
        step = np.array([[1.0, -tau[k]], [0.0, 1.0]])
        effect[k] = step @ effect[k - 1]
        effect[k, 0, 2 + 2 * k] += 1.0
        effect[k, 1, 3 + 2 * k] += 1.0
        walk = NOISE.gyro_bias_walk**2
        angle = NOISE.gyro_random_walk**2 * tau[k] + NOISE.turn_noise**2 * float(one.turning[k])
        covariance[2 + 2 * k : 4 + 2 * k, 2 + 2 * k : 4 + 2 * k] = [
            [angle + tau[k] ** 2 * walk / 3.0, -0.5 * tau[k] * walk],
            [-0.5 * tau[k] * walk, walk],
        ]
    rows, columns, target, noise = [], [], [], []
    for k in range(blocks):
        if still[k] > 0.0:
            rows.append(effect[k, 1])
            columns.append(one.rest_terms[k].numpy())
            target.append(float(one.rest_rate[k]))
            noise.append(NOISE.rest**2 / still[k])
        elif math.isfinite(float(one.error[k])):
            rows.append(effect[k, 0])
            columns.append(one.turned[k].numpy())
            target.append(float(one.error[k]))
            noise.append(float(one.variance[k]))
    observed = np.array(rows)
    whole = observed @ covariance @ observed.T + np.diag(noise)
    return np.array(columns), np.array(target), whole


def test_rows_are_least_squares_with_the_whole_covariance() -> None:
    one = curve(np.random.default_rng(1))
    rows = whitened_rows(one, NOISE)
    prior = np.array([0.03, 0.009, 1e-3])
    found = solve_ridge(
        rows.columns, rows.target, torch.from_numpy(prior), torch.tensor([len(rows.target)])
    )
    columns, target, covariance = written_out(one)
    weight = np.linalg.inv(covariance)
    information = columns.T @ weight @ columns + np.diag(prior**-2)
    theta = np.linalg.solve(information, columns.T @ weight @ target)
    np.testing.assert_allclose(found.coefficients[0], theta, rtol=1e-7)
    np.testing.assert_allclose(found.covariance[0], np.linalg.inv(information), rtol=1e-7)


def test_rows_before_an_origin_do_not_see_what_comes_after() -> None:
    one = curve(np.random.default_rng(2))
    short = AzimuthCurve(*(part[:50] for part in one))
    whole, part = whitened_rows(one, NOISE), whitened_rows(short, NOISE)
    count = int(torch.searchsorted(whole.sample, int(one.end[49]), right=True))
    assert count == len(part.target)
    assert torch.equal(whole.columns[:count], part.columns)
    assert torch.equal(whole.target[:count], part.target)
    assert torch.equal(whole.angle[:50], part.angle)


def test_coefficients_drawn_from_the_noise_err_as_told() -> None:
    rng = np.random.default_rng(3)
    one = curve(rng)
    columns, _, covariance = written_out(one)
    root = np.linalg.cholesky(covariance)
    prior = np.array([0.03, 0.009, 1e-3])
    resting, told = one.rest > 0.0, torch.isfinite(one.error)
    order = torch.nonzero(resting | told).squeeze(-1)
    squares = []
    for _ in range(150):
        theta = rng.standard_normal(TERMS) * prior
        measured = torch.from_numpy(columns @ theta + root @ rng.standard_normal(len(root)))
        error, rate = one.error.clone(), one.rest_rate.clone()
        error[order[told[order]]] = measured[told[order]]
        rate[order[resting[order]]] = measured[resting[order]]
        rows = whitened_rows(one._replace(error=error, rest_rate=rate), NOISE)
        found = solve_ridge(
            rows.columns, rows.target, torch.from_numpy(prior), torch.tensor([len(rows.target)])
        )
        off = found.coefficients[0].numpy() - theta
        squares.append(off @ np.linalg.solve(found.covariance[0].numpy(), off))
    # chi-square with 3 degrees, mean of 150 draws, 99.9 %
    assert np.mean(squares) == pytest.approx(3.0, abs=3.3 * math.sqrt(6.0 / 150.0))


@pytest.fixture(scope="module")
def driven() -> tuple[NavigatorRun, np.ndarray, EkfOptions]:
    """A run with a badly calibrated gyro, and the true azimuth at the ends of its intervals."""
    drive = simulate_drive(
        profile="town", grade="mems_x", duration=500.0, seed=12, imu_rate_hz=10.0, name="told"
    )
    line = riss_timeline(drive.log, rate_hz=10.0)
    options = EkfOptions(mechanization=RissOptions(dimensions=2))
    run = Navigator(NavigatorOptions(filter=options)).run(line.samples, line.fixes, line.timing)
    truth = drive.log.reference
    assert truth is not None
    azimuth = np.interp(line.t.numpy(), truth["t"], np.unwrap(truth["azimuth"]))
    return run, azimuth[run.first :], options


def test_what_fixes_told_is_free_of_the_gyros_error(
    driven: tuple[NavigatorRun, np.ndarray, EkfOptions],
) -> None:
    run, truth, _ = driven
    azimuth, variance = azimuth_told(run.history)
    told = torch.isfinite(variance) & (run.history.end > 600)
    true = torch.from_numpy(truth)[run.history.end]
    error = torch.remainder(azimuth - true + math.pi, 2.0 * math.pi) - math.pi
    z = (error / variance.sqrt())[told].numpy()
    filtered = (run.history.belief.state.azimuth - true)[told]
    filtered = torch.remainder(filtered + math.pi, 2.0 * math.pi) - math.pi
    assert len(z) > 250
    # each fix errs for itself, though the filter's azimuth drags the gyro's error along
    assert abs(np.corrcoef(z[1:], z[:-1])[0, 1]) < 0.25
    assert np.corrcoef(filtered[1:], filtered[:-1])[0, 1] > 0.6
    assert abs(z.mean()) < 3.3 * z.std() / math.sqrt(len(z))
    assert 0.3 < z.std() < 1.2


def test_the_curve_is_that_of_the_raw_gyro(
    driven: tuple[NavigatorRun, np.ndarray, EkfOptions],
) -> None:
    run, _, options = driven
    count = len(run.samples.dt)
    none = torch.zeros(count, 0, dtype=torch.float64)
    found = azimuth_curve(run, options, none, count)
    moving = run.samples.dt * (1.0 - run.samples.stationary)
    raw = -torch.cumsum(run.samples.yaw_rate * moving, 0)[found.end]
    earth = 7.292115e-5 * torch.sin(run.history.belief.state.lat)
    drift = (found.raw - found.raw[0]) - (raw - raw[0])
    # what is left is the turn of the Earth while the car moves; 6e-4 rad are left to the local
    # level, which turns by v_e tan(lat) / r
    moved = torch.cumsum(moving, 0)[found.end]
    expected = earth * (moved - moved[0])
    assert float((drift - expected).abs().max()) < 6e-4


def test_sums_over_blocks() -> None:
    values = torch.arange(12, dtype=torch.float64).reshape(6, 2)
    found = sums_over_blocks(values, torch.tensor([1, 2, 5]))
    assert found.tolist() == [[2.0, 4.0], [4.0, 5.0], [24.0, 27.0]]


def test_what_cannot_be_regressed_is_refused(
    driven: tuple[NavigatorRun, np.ndarray, EkfOptions],
) -> None:
    run, _, options = driven
    none = torch.zeros(5, 0, dtype=torch.float64)
    with pytest.raises(FitError, match="no past"):
        azimuth_curve(run, options, none, 5)
    with pytest.raises(ConfigError, match="Shen"):
        azimuth_curve(run, EkfOptions(model="shen2010"), none, 5)
    with pytest.raises(ConfigError, match="rest"):
        AzimuthNoise(rest=0.0)
