"""Gyro error terms as states: found where they are, as sure as they say, seen at standstill."""

import math

import pytest
import torch

from navlearn import wgs84
from navlearn.filters.consistency import mean_band, nees
from navlearn.fusion import convergence
from navlearn.fusion.error_state import error_layout, initial_belief, position_difference
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind
from navlearn.fusion.options import (
    GYRO_TERMS,
    EkfOptions,
    GateOptions,
    InitialOptions,
    NoiseOptions,
)
from navlearn.fusion.sensor_errors import gyro_regressor
from navlearn.fusion.separate_parameter import separate_parameter
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix, NavState, RissSample

TRUTH = {
    "bias": 0.002,
    "scale": 0.03,
    "abs_scale": -0.01,
    "quadratic": 0.02,
    "f_x": 4e-4,
    "f_y": -3e-4,
}
QUIET = NoiseOptions(gyro_random_walk=2e-4, turn_noise=1e-4, gyro_bias_walk=1e-7)


def with_gyro_errors(d, theta):
    """Let the gyro of a drive read ω + Σ g θ, the regressors g of what it reads."""
    speed, rate = d.samples.speed, d.samples.yaw_rate
    f_y = torch.diff(speed, dim=-1, prepend=speed[..., :1]) / d.samples.dt
    samples = d.samples._replace(f_x=-speed * rate, f_y=f_y)
    for _ in range(30):  # a contraction: every error is small beside the rate
        error = sum(value * gyro_regressor(term, samples) for term, value in theta.items())
        samples = samples._replace(yaw_rate=rate + error)
    return d._replace(samples=samples)


def estimates(options, history):
    layout = error_layout(options)
    told = {}
    for term in options.gyro_states:
        at = layout.sensors.index(f"gyro_{term}")
        row = layout.first_sensor + at
        last = history.belief.covariance[:, -1]
        told[term] = (history.belief.sensor[:, -1, at], last[:, row, row].sqrt())
    return told


@pytest.mark.parametrize(("dims", "odometer"), [(2, ("scale",)), (3, ("scale", "delay", "offset"))])
def test_terms_converge_to_the_truth(make_drive, dims, odometer):
    flat = {"pitch_bias": 0.0} if dims == 2 else {}
    d = with_gyro_errors(make_drive(seconds=300, rate=5, batch=2, bias=0.0, **flat), TRUTH)
    options = EkfOptions(
        gyro_terms=GYRO_TERMS,
        speed_terms=odometer,
        noise=QUIET,
        standstill=1.0,
        mechanization=RissOptions(dimensions=dims),
    )
    if dims == 2:  # a level road
        level = torch.zeros_like(d.samples.pitch)
        d = d._replace(samples=d.samples._replace(pitch=level, roll=level))
    history = filtered(options, d, "fast")
    for term, (value, sigma) in estimates(options, history).items():
        assert float(((value - TRUTH[term]) / sigma).abs().max()) < 3.0, term
        assert float(sigma.max()) < options.initial.gyro[term], term
    scale, sigma = estimates(options, history)["scale"]
    assert float(sigma.max()) < 0.006
    assert float((scale - TRUTH["scale"]).abs().max()) < 0.015


def test_both_forms_agree(make_drive):
    d = with_gyro_errors(make_drive(seconds=30, rate=10, bias=0.0), TRUTH)
    odometer = ("scale", "delay", "offset")
    options = EkfOptions(gyro_terms=GYRO_TERMS, speed_terms=odometer, noise=QUIET, standstill=1.0)
    exact, quick = (filtered(options, d, method) for method in ("exact", "fast"))
    assert quick.method == "fast"
    sigma = exact.belief.covariance[0, -1].diagonal().sqrt()[4:]
    apart = (exact.belief.sensor - quick.belief.sensor)[0, -1].abs()
    assert float((apart / sigma).max()) < 1e-4


def filtered(options, d, method, fixes=None):
    begin = initial_belief(options, d.start)
    with torch.no_grad():
        return LooselyCoupledEkf(options)(
            begin, d.samples, fixes or d.fixes, d.timing, method=method
        )


def monte_carlo(make_drive, runs):
    """Run a filter with all gyro terms on drives whose errors are drawn from its own model."""
    gyro = {"bias": 1e-3, "scale": 0.02, "abs_scale": 0.01, "f_x": 3e-4, "f_y": 3e-4}
    gyro["quadratic"] = 0.02
    initial = InitialOptions(
        position=2.0, height=2.0, azimuth=0.03, gyro=gyro, speed={"scale": 0.01}
    )
    noise = NoiseOptions(
        gyro_random_walk=5e-4,
        turn_noise=0.0,
        gyro_bias_walk=1e-7,
        speed_scale_walk=1e-7,
        position_walk=1e-3,
        height_walk=1e-3,
        hill_walk=1e-3,
        position_inflation=1.0,
        position_floor=0.0,
        height_floor=0.0,
        velocity_floor=0.0,
        speed_noise=0.0,
    )
    options = EkfOptions(
        gyro_terms=GYRO_TERMS,
        initial=initial,
        noise=noise,
        gate=GateOptions(probability=1.0),
        zero_yaw_rate=False,
        pitch_bias=False,
    )
    g = torch.Generator().manual_seed(12)

    def draw(sigma):
        return sigma * torch.randn(runs, 1, generator=g, dtype=torch.float64)

    theta, scale = {term: draw(gyro[term]) for term in GYRO_TERMS}, draw(0.01)
    d = make_drive(
        seconds=60,
        rate=10,
        batch=runs,
        seed=6,
        bias=0.0,
        scale=scale,
        pitch_bias=0.0,
        gyro_random_walk=5e-4,
    )
    d = with_gyro_errors(d, theta)
    d = d._replace(samples=d.samples._replace(stationary=torch.zeros_like(d.samples.dt)))
    belief = initial_belief(options, d.start)
    wrong = torch.cat((draw(2.0), draw(2.0), draw(2.0), draw(0.03)), 1)
    lat, lon, height, azimuth = d.start
    begin = NavState(
        lat + wrong[:, 1] / 6.38e6,
        lon + wrong[:, 0] / (6.38e6 * torch.cos(lat)),
        height + wrong[:, 2],
        azimuth + wrong[:, 3],
    )
    with torch.no_grad():
        history = LooselyCoupledEkf(options)(
            belief._replace(state=begin), d.samples, d.fixes, d.timing
        )
    truth = NavState(*(torch.gather(x.expand(runs, -1), 1, history.end) for x in d.truth[:4]))
    at = history.belief
    known = torch.cat((*(theta[term] for term in GYRO_TERMS), scale), 1)
    error = torch.cat(
        (
            position_difference(at.state, truth),
            (at.state.azimuth - truth.azimuth).unsqueeze(-1),
            at.sensor - known.unsqueeze(1),
        ),
        -1,
    )
    return nees(error, at.covariance)


def test_terms_are_as_sure_as_they_say(make_drive):
    squares = monte_carlo(make_drive, 20)
    band = mean_band(squares_degrees(), 20)
    epochs = squares.mean(0)
    assert float(((epochs > band.low) & (epochs < band.high)).double().mean()) > 0.8


@pytest.mark.slow
def test_terms_are_as_sure_as_they_say_over_a_hundred_runs(make_drive):
    squares = monte_carlo(make_drive, 100)
    band = mean_band(squares_degrees(), 100)
    epochs = squares.mean(0)
    assert band.low < float(epochs.mean()) < band.high
    assert float(((epochs > band.low) & (epochs < band.high)).double().mean()) > 0.85


def squares_degrees():
    return 4 + len(GYRO_TERMS) + 1


def parked(seconds, rate, fix_rate, theta):
    """Return a car that stands still on a slope, with fixes so many times a second."""
    n = seconds * rate
    zero = torch.zeros(1, n, dtype=torch.float64)
    wave = torch.sin(torch.arange(n, dtype=torch.float64) * 0.01).expand(1, -1)
    earth = wgs84.EARTH_RATE * math.sin(0.77)
    one = zero + 1.0
    samples = RissSample(one / rate, zero, zero, zero, zero, 0.5 * wave, 1.0 + wave, one)
    told = earth + theta["bias"] + theta["f_x"] * samples.f_x + theta["f_y"] * samples.f_y
    samples = samples._replace(yaw_rate=told)
    index = torch.arange(rate // fix_rate - 1, n, rate // fix_rate).expand(1, -1).contiguous()
    here = torch.ones(index.shape, dtype=torch.float64)
    fixes = GnssFix(*(0.0 * here for _ in GnssFix._fields))
    fixes = fixes._replace(lat=0.77 * here, lon=-1.33 * here, height=100.0 * here)
    start = NavState(*(torch.full((1,), x, dtype=torch.float64) for x in (0.77, -1.33, 100.0, 0.5)))
    return start, samples, fixes, FixTiming(index, 0.0 * here)


def test_standstill_observes_the_terms_as_a_regression_would():
    terms = ("bias", "f_x", "f_y")
    options = EkfOptions(
        gyro_terms=terms,
        standstill=1.0,
        noise=NoiseOptions(gyro_bias_walk=0.0),
        mechanization=RissOptions(dimensions=2),
    )
    start, samples, fixes, timing = parked(30, 10, 1, TRUTH)
    with torch.no_grad():
        history = LooselyCoupledEkf(options)(initial_belief(options, start), samples, fixes, timing)
    assert int((history.verdict[0, :, Kind.ZERO_YAW_RATE] > 0).sum()) == 30
    prior = torch.tensor([options.initial.gyro[term] for term in terms], dtype=torch.float64)
    rows = torch.stack([gyro_regressor(term, samples)[0] for term in terms], -1)
    rows = rows.reshape(30, 10, 3).mean(1)
    target = samples.yaw_rate[0].reshape(30, 10).mean(1) - wgs84.EARTH_RATE * math.sin(0.77)
    variance = options.noise.zero_yaw_rate**2 + options.noise.gyro_random_walk**2
    information = torch.diag(prior**-2) + rows.T @ rows / variance
    expected = torch.linalg.solve(information, rows.T @ target / variance)
    covariance = torch.linalg.inv(information)
    torch.testing.assert_close(history.belief.sensor[0, -1, :3], expected, rtol=1e-6, atol=1e-12)
    torch.testing.assert_close(
        history.belief.covariance[0, -1, 4:7, 4:7], covariance, rtol=1e-6, atol=1e-14
    )


@pytest.mark.parametrize("fix_rate", [1, 2, 5, 10])
def test_standstill_counts_across_blocks(fix_rate):
    options = EkfOptions(
        standstill=1.0,
        noise=NoiseOptions(gyro_bias_walk=0.0),
        mechanization=RissOptions(dimensions=2),
    )
    start, samples, fixes, timing = parked(20, 10, fix_rate, TRUTH)
    with torch.no_grad():
        history = LooselyCoupledEkf(options)(initial_belief(options, start), samples, fixes, timing)
    seen = history.verdict[0, :, Kind.ZERO_YAW_RATE] > 0
    time = (history.end[0] + 1) / 10.0
    assert torch.equal(seen, time >= 1.0 - 1e-6)
    # more fixes a second must not make the gyro's bias known any better
    r = options.noise.zero_yaw_rate**2 + options.noise.gyro_random_walk**2
    told = 20.0 - 1.0 + 1.0 / fix_rate
    expected = (options.initial.gyro["bias"] ** -2 + told / r) ** -0.5
    assert float(history.belief.covariance[0, -1, 4, 4].sqrt()) == pytest.approx(expected, rel=1e-6)


def test_the_fast_form_settles_where_the_gate_resets_late(make_drive, monkeypatch):
    d = make_drive(seconds=120, rate=5)
    options = EkfOptions()
    away = torch.zeros_like(d.fixes.lat)
    away[:, 60:76] = 35.0 / 6.38e6
    fixes = d.fixes._replace(lat=d.fixes.lat + away)
    exact, quick = (filtered(options, d, method, fixes) for method in ("exact", "fast"))
    assert int(exact.resets.sum()) == 2
    assert quick.method == "fast"
    assert torch.equal(exact.verdict, quick.verdict)
    apart = position_difference(exact.belief.state, quick.belief.state)
    assert float(apart.abs().max()) < 1e-2
    # had it gone on forgetting the verdicts after a pass that moved far, it would go round
    monkeypatch.setattr(convergence, "EARLY", convergence.MOST_PASSES)
    assert filtered(options, d, "fast", fixes).method == "exact"


def test_a_separate_parameter_is_that_of_a_state(make_drive):
    """The gyro's scale, once as a state, once from two runs without that state."""
    d = with_gyro_errors(make_drive(seconds=200, rate=5, bias=0.0), {"bias": 0.002, "scale": 0.02})
    plain = EkfOptions(noise=QUIET, gate=GateOptions(probability=1.0), standstill=1.0)
    richer = EkfOptions(noise=QUIET, gate=plain.gate, standstill=1.0, gyro_terms=("bias", "scale"))
    amount, rate = 1e-3, d.samples.yaw_rate
    filters = [LooselyCoupledEkf(plain), LooselyCoupledEkf(plain), LooselyCoupledEkf(richer)]
    histories = []
    for ekf, less in zip(filters, (0.0, amount, 0.0), strict=True):
        samples = d.samples._replace(yaw_rate=rate - less * rate)
        one = [RissSample(*(x[0] for x in samples)), GnssFix(*(x[0] for x in d.fixes))]
        timing = FixTiming(*(x[0] for x in d.timing))
        begin = initial_belief(ekf.options, NavState(*(x[0] for x in d.start)))
        with torch.no_grad():
            histories.append(ekf(begin, *one, timing, method="fast"))
    raw, less, state = histories
    found = separate_parameter(filters[0].model, raw, less, amount, prior=0.03)
    expected = state.belief.sensor[:, 1]
    sigma = state.belief.covariance[:, 5, 5].sqrt()
    settled = slice(60, None)
    assert float(((found.value - expected) / sigma)[settled].abs().max()) < 1.0
    assert 0.4 < float((found.sigma / sigma)[settled].median()) < 2.5
    assert abs(float(found.value[-1]) - 0.02) < 3.0 * float(found.sigma[-1])
    # what is believed with it is what the filter with that state believes
    apart = position_difference(found.belief.state, state.belief.state)[settled]
    alone = position_difference(raw.belief.state, state.belief.state)[settled]
    assert float(apart[:, :2].norm(dim=-1).mean()) < 0.2 * float(alone[:, :2].norm(dim=-1).mean())
