"""Smoothed full-IMU drives: against the joint Gaussian, through outages, as good as they say."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import scipy.linalg
import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import matrix_from_angles, quaternion_from_angles
from navlearn.errors import ShapeError
from navlearn.filters.consistency import mean_band, nees
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.frames import shift_geodetic
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import moved_state, state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.fusion.ins.smoothed_path import spread_over
from navlearn.fusion.ins.smoothing import SmoothedInsDrive, smooth_ins
from navlearn.fusion.ins.smoothing_pass import belief_difference
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.ins.timeline import ins_timeline
from navlearn.fusion.ins.updates import ins_measured
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.smoothing import SmoothingOptions
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

ONCE = SmoothingOptions(passes=1)
RATE = 10
INITIAL = InsInitialOptions(
    position=2.0, height=2.0, velocity=0.2, tilt=0.005, azimuth=0.03, gyro_bias=5e-4,
    accel_bias=0.02, gyro_scale=1e-3, accel_scale=1e-3,
)  # fmt: skip
NOISE = InsNoiseOptions(
    gyro_random_walk=3e-4, accel_random_walk=5e-3, turn_noise=0.0, gyro_bias_walk=1e-7,
    accel_bias_walk=1e-6, gyro_scale_walk=1e-8, accel_scale_walk=1e-8, position_inflation=1.0,
    position_floor=0.0, height_floor=0.0, velocity_floor=0.0,
)  # fmt: skip
PLAIN = InsEkfOptions(
    initial=INITIAL, noise=NOISE, gate=GateOptions(probability=1.0), odometer=False,
    nonholonomic=False, zero_velocity=False, zero_angular_rate=False,
)  # fmt: skip
VARIANTS = {
    "15 states": PLAIN,
    "21 states": replace(PLAIN, states=21),
    "9 states": replace(PLAIN, states=9),
    "open loop": replace(PLAIN, feedback="open"),
    "dahmane2022": replace(PLAIN, model="dahmane2022"),
    "gauss_markov": replace(PLAIN, correlation_time=3000.0),
    "position only": replace(PLAIN, velocity=False),
}


class Drive(NamedTuple):
    start: InsState
    truth: InsState
    samples: ImuSample
    fixes: GnssFix
    timing: FixTiming


def drive(options=PLAIN, seconds=60, batch=1, seed=0) -> tuple[Drive, InsBelief, Tensor]:
    """Cars whose errors are drawn from the filter's own model; belief at the start, sensors."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    count, dt = seconds * RATE, 1.0 / RATE
    t = (torch.arange(count, dtype=torch.float64) + 0.5) * dt
    phase = 6.28 * torch.rand(batch, 2, 1, generator=g, dtype=torch.float64)
    speed = 12.0 + 8.0 * torch.sin(0.15 * t + phase[:, 0])
    gain = 1.2 * torch.cos(0.15 * t + phase[:, 0])
    turn = 0.2 * torch.sin(0.11 * t + phase[:, 1])
    lat = torch.full((batch,), 0.77, dtype=torch.float64)
    azimuth = 0.5 - torch.cumsum(turn, -1) * dt + 0.5 * dt * turn
    zero = torch.zeros_like(turn)
    C_lb = matrix_from_angles(azimuth, zero, zero)
    sensed = (C_lb.transpose(-1, -2) @ earth.earth_rate_enu(lat)[:, None, :, None]).squeeze(-1)
    weight = earth.normal_gravity(lat, 100.0 + 0.0 * lat)[:, None].expand_as(turn)
    omega = sensed + torch.stack((zero, zero, turn), -1)
    force = torch.stack((-speed * turn, gain, weight), -1)
    clean = ImuSample(zero + dt, omega, force, speed, zero, zero)
    begin = matrix_from_angles(0.5 + 0.0 * lat, 0.0 * lat, 0.0 * lat)[..., 1]
    start = InsState(
        lat, 0.1 + 0.0 * lat, 100.0 + 0.0 * lat, begin * (speed - 0.5 * dt * gain)[:, :1],
        quaternion_from_angles(0.5 + 0.0 * lat, 0.0 * lat, 0.0 * lat),
    )  # fmt: skip
    truth = strapdown_over_time(start, clean)
    sigma = initial_ins_belief(options, start).covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    wrong = sigma * normal(batch, options.states)
    sensor = torch.zeros(batch, 12, dtype=torch.float64)
    sensor[:, : options.states - 9] = -wrong[:, 9:]  # the estimate starts at zero
    gyro = omega * (1.0 + sensor[:, None, 6:9]) + sensor[:, None, :3]
    accel = force * (1.0 + sensor[:, None, 9:]) + sensor[:, None, 3:6]
    noise = options.noise
    samples = clean._replace(
        omega_ib_b=gyro + noise.gyro_random_walk / math.sqrt(dt) * normal(batch, count, 3),
        f_b=accel + noise.accel_random_walk / math.sqrt(dt) * normal(batch, count, 3),
    )
    index = torch.arange(RATE - 1, count, RATE).expand(batch, -1).contiguous()
    at = [torch.gather(x, 1, index) for x in truth[:3]]
    shape = index.shape
    where = shift_geodetic(*at, *(1.5 * normal(*shape) for _ in range(3)))
    velocity = truth.v_l[:, RATE - 1 :: RATE] + 0.1 * normal(*shape, 3)
    one = torch.ones(shape, dtype=torch.float64)
    fixes = GnssFix(*where, *velocity.unbind(-1), *([1.5 * one] * 3), 0.1 * one, one, one)
    belief = initial_ins_belief(options, start)._replace(state=moved_state(start, wrong))
    found = Drive(start, truth, samples, fixes, FixTiming(index, 0.0 * one))
    return found, belief, sensor[:, : options.states - 9]


def without_fixes(d: Drive, first: int, last: int) -> Drive:
    """Take the fixes of some seconds away."""
    seconds = torch.arange(d.timing.index.shape[1])
    keep = (seconds < first) | (seconds >= last)
    fixes = GnssFix(*(channel[:, keep] for channel in d.fixes))
    return d._replace(fixes=fixes, timing=FixTiming(*(x[:, keep] for x in d.timing)))


def run(options, d, belief, method="exact", smoothing=None):
    with torch.no_grad():
        ekf = InsEkf(options)
        history = ekf(belief, d.samples, d.fixes, d.timing, method=method)
        found = smooth_ins(ekf, belief, d.samples, d.fixes, d.timing, history, smoothing)
    return ekf, history, found


def at(state: InsState, k) -> InsState:
    return InsState(*(channel[:, k] for channel in state))


def error(path: InsState, truth: InsState) -> Tensor:
    return state_difference(path, truth)


@pytest.mark.parametrize(
    "name", ["15 states", "21 states", "9 states", "dahmane2022", "gauss_markov"]
)
def test_one_pass_is_the_joint_gaussian_of_the_filters_linear_model(name) -> None:
    """All deviations from the filter's predictions, conditioned at once on all innovations."""
    options = VARIANTS[name]
    d, belief, _ = drive(options, seconds=9)
    d = without_fixes(d, 4, 7)
    ekf, history, found = run(options, d, belief, smoothing=ONCE)
    line = ins_timeline(ekf.model, d.samples, d.fixes, d.timing)
    told = ins_measured(ekf.model, history.prior, line.occasion, ekf.noise)
    H, y = told.observation[0].numpy(), told.innovation[0].numpy()
    phi, count, n = found.transition[0].numpy(), len(y), options.states
    before = [belief.covariance[0].numpy(), *history.belief.covariance[0].numpy()]
    ahead = history.prior.covariance[0].numpy()
    Q = [ahead[k] - phi[k] @ before[k] @ phi[k].T for k in range(count)]
    moved = belief_difference(history.prior, history.belief)[0].numpy()
    A, b = np.eye(n * (count + 1)), np.zeros(n * (count + 1))
    for k in range(count):
        here = slice(n * (k + 1), n * (k + 2))
        A[here, n * k : n * (k + 1)] = -phi[k]
        b[here] = phi[k] @ moved[k - 1] if k else 0.0
    unroll = np.linalg.inv(A)
    m, P = unroll @ b, unroll @ scipy.linalg.block_diag(before[0], *Q) @ unroll.T
    C = np.hstack((np.zeros((y.size, n)), scipy.linalg.block_diag(*H)))
    S = C @ P @ C.T + np.diag(told.variance[0].numpy().ravel())
    gain = np.linalg.solve(S, C @ P).T
    m, P = m + gain @ (y.ravel() - C @ m), P - gain @ C @ P
    got = [belief_difference(found.start, belief)[0].numpy()]
    got += list(belief_difference(found.belief, history.prior)[0].numpy())
    smoothed = [found.start.covariance[0].numpy(), *found.belief.covariance[0].numpy()]
    for k in range(count + 1):
        here = slice(n * k, n * (k + 1))
        sigma = np.sqrt(np.diagonal(before[k]))
        np.testing.assert_allclose(got[k] / sigma, m[here] / sigma, atol=2e-5)
        unit = np.outer(sigma, sigma)
        np.testing.assert_allclose(smoothed[k] / unit, P[here, here] / unit, atol=2e-6)


@pytest.mark.parametrize("name", VARIANTS)
def test_smoothing_bridges_an_outage(name) -> None:
    options = VARIANTS[name]
    # what a filter of 9 states does not estimate is not there
    drawn = options if options.states == 9 else PLAIN
    d, belief, _ = drive(drawn, seconds=60, batch=6, seed=2)
    if options.states == 21:
        belief = initial_ins_belief(options, belief.state)
    d = without_fixes(d, 25, 45)
    _, history, found = run(options, d, belief)
    inside = slice(25 * RATE, 45 * RATE)
    before, after = (
        error(path, d.truth)[:, inside].abs().amax(1).mean(0)
        for path in (history.trajectory, found.trajectory)
    )
    assert float(after[:2].norm()) < 0.3 * float(before[:2].norm())
    assert float(after[3:5].norm()) < 0.5 * float(before[3:5].norm())
    assert float(after[8]) < float(before[8])
    sigma = history.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    unit = sigma.unsqueeze(-1) * sigma.unsqueeze(-2)
    assert float(torch.linalg.eigvalsh(found.belief.covariance / unit).min()) > -1e-12


def test_smoothed_errors_are_as_large_as_they_say() -> None:
    """NEES of 40 drives drawn from the model, at the start, in the outage, and after it."""
    d, belief, sensor = drive(seconds=50, batch=40, seed=5)
    d = without_fixes(d, 20, 35)
    _, history, found = run(PLAIN, d, belief, smoothing=SmoothingOptions(passes=4))
    seconds = [4, 20, 27, 33, 40, 49]
    ends = found.end[0, seconds]
    truth = at(d.truth, ends)
    for believed, low, high in ((found.belief, 0.85, 1.15), (history.belief, 0.85, 1.15)):
        some = map_ins_belief(believed, lambda x: x[:, seconds])
        wrong = torch.cat((error(some.state, truth), some.sensor - sensor.unsqueeze(1)), -1)
        told = nees(wrong, some.covariance).mean(0)
        band = mean_band(15, 40, 0.999)
        assert bool((told > low * band.low).all()), told
        assert bool((told < high * band.high).all()), told
    before = map_ins_belief(found.start, lambda x: x)
    wrong = torch.cat((error(before.state, d.start), before.sensor - sensor), -1)
    assert band.low < float(nees(wrong, before.covariance).mean()) < band.high


def test_the_last_belief_is_the_filters() -> None:
    d, belief, _ = drive(seconds=20)
    _, history, found = run(PLAIN, d, belief, smoothing=ONCE)
    last, filtered = (map_ins_belief(x.belief, lambda y: y[:, -1]) for x in (found, history))
    assert float(belief_difference(last, filtered).abs().max()) < 1e-6
    torch.testing.assert_close(last.covariance, filtered.covariance, rtol=1e-8, atol=1e-16)


def test_the_path_is_smooth_and_ends_blocks_where_the_beliefs_are() -> None:
    d, belief, _ = drive(seconds=40, seed=3)
    d = without_fixes(d, 15, 25)
    _, history, found = run(PLAIN, d, belief)

    def jump(path: InsState) -> float:
        """Largest way in an interval beyond what the mean of the velocities says."""
        way = error(at(path, slice(1, None)), at(path, slice(None, -1)))[..., :3]
        mean = 0.5 * (path.v_l[:, 1:] + path.v_l[:, :-1])
        return float((way - mean / RATE).abs().max())

    assert jump(found.trajectory) < 0.02
    assert jump(history.trajectory) > 0.2
    for path, state in zip(found.trajectory, found.belief.state, strict=True):
        assert torch.equal(path[:, found.end[0]], state)
    norm = found.trajectory.q_lb.norm(dim=-1)
    torch.testing.assert_close(norm, torch.ones_like(norm), rtol=0.0, atol=1e-12)


def test_what_is_left_is_spread_so_that_velocity_is_the_slope_of_the_way() -> None:
    dt = torch.tensor([[0.1] * 10 + [0.0] * 2, [0.0] * 12], dtype=torch.float64)
    left = torch.arange(1.0, 10.0, dtype=torch.float64).expand(2, 9)
    found = spread_over(left, dt)
    torch.testing.assert_close(found[0, 9:], left[:1].expand(3, 9))
    torch.testing.assert_close(found[1], left[:1].expand(12, 9))
    fine = spread_over(left[:1], torch.full((1, 1000), 1e-3, dtype=torch.float64))[0]
    slope = (fine[2:, :3] - fine[:-2, :3]) / 2e-3
    torch.testing.assert_close(slope, fine[1:-1, 3:6], rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("method", ["sequential", "fast"])
def test_every_form_of_the_filter_smooths_alike(method) -> None:
    d, belief, _ = drive(seconds=20, batch=2)
    d = without_fixes(d, 8, 14)
    _, _, exact = run(PLAIN, d, belief)
    _, _, other = run(PLAIN, d, belief, method)
    assert float(error(other.trajectory, exact.trajectory)[..., :6].abs().max()) < 1e-4


def test_what_the_gate_refused_stays_refused() -> None:
    options = replace(PLAIN, gate=GateOptions())
    d, belief, _ = drive(options, seconds=30, seed=4)
    spoilt = d.fixes.lat.clone()
    spoilt[:, 15] += 300.0 / 6.4e6
    wild = d._replace(fixes=d.fixes._replace(lat=spoilt))
    _, history, found = run(options, wild, belief)
    assert int(history.verdict[0, 15, InsKind.POSITION]) == int(Verdict.REFUSED_BY_GATE)
    silent = torch.ones_like(spoilt)
    silent[:, 15] = 0.0
    _, _, without = run(options, d._replace(fixes=d.fixes._replace(has_position=silent)), belief)
    assert float(error(found.trajectory, without.trajectory).abs().max()) < 1e-3


def test_nothing_is_known_across_a_reset() -> None:
    """A receiver that is 500 m off for good: refused, then believed by force."""
    options = replace(PLAIN, gate=GateOptions(reset_after=5))
    d, belief, _ = drive(options, seconds=40, seed=6)
    off = d.fixes.lat + torch.where(torch.arange(40) >= 20, 500.0 / 6.4e6, 0.0)
    _, history, found = run(options, d._replace(fixes=d.fixes._replace(lat=off)), belief)
    verdict = history.verdict[0, :, InsKind.POSITION]
    reset = int((verdict == int(Verdict.ACCEPTED_BY_RESET)).nonzero()[0])
    assert reset == 25
    wrong = error(found.trajectory, d.truth)[0]
    assert float(wrong[: reset * RATE, 1].abs().max()) < 20.0
    assert float((wrong[(reset + 3) * RATE :, 1] - 500.0).abs().max()) < 20.0


def test_a_single_drive_needs_no_batch_axis() -> None:
    d, belief, _ = drive(seconds=15)
    _, _, batched = run(PLAIN, d, belief)

    def first(item):
        return type(item)(*(x[0] for x in item))

    single = Drive(*(first(x) for x in d))
    _, _, found = run(PLAIN, single, map_ins_belief(belief, lambda x: x[0]))
    assert isinstance(found, SmoothedInsDrive)
    assert found.passes == batched.passes
    for a, b in zip(found.trajectory, batched.trajectory, strict=True):
        torch.testing.assert_close(a, b[0])
    torch.testing.assert_close(found.belief.covariance, batched.belief.covariance[0])


def test_a_history_of_other_samples_is_refused() -> None:
    d, belief, _ = drive(seconds=15)
    ekf, history, _ = run(PLAIN, d, belief)
    fewer = without_fixes(d, 3, 12)
    fixes, timing = fewer.fixes, FixTiming(fewer.timing.index - 3, fewer.timing.delay)
    with pytest.raises(ShapeError, match="end elsewhere"):
        smooth_ins(ekf, belief, d.samples, fixes, timing, history)
