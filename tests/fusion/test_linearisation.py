"""Every analytic derivative of the filter against automatic ones of the nonlinear functions."""

import math

import pytest
import torch

from navlearn.filters.belief import Belief
from navlearn.fusion.block_motion import move_block
from navlearn.fusion.blocks import cut
from navlearn.fusion.error_state import initial_belief, position_difference
from navlearn.fusion.filter_model import difference, fed_back, filter_model, predict_blocks
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.measured import Occasion
from navlearn.fusion.noise import log_noise, noise_from_log
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.standstill import Rest, rest_at_end
from navlearn.fusion.updates import measured
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import GnssFix, NavState, RissSample

ALL = ("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y")
MODELS = {
    "default": EkfOptions(),
    "augmented": EkfOptions(gyro_terms=ALL, speed_terms=("scale", "delay", "offset")),
    "flat": EkfOptions(
        speed_terms=("scale", "delay", "offset"), mechanization=RissOptions(dimensions=2)
    ),
    "gauss_markov": EkfOptions(correlation_time=30.0),
    "lever": EkfOptions(lever_arm=(0.5, -1.2, 1.7), speed_terms=("scale", "delay", "offset")),
    "course": EkfOptions(velocity=False, course=True),
    "shen2010_full": EkfOptions(model="shen2010_full", lever_arm=(0.5, -1.2, 1.7)),
}


def block(n: int = 50, seed: int = 3) -> tuple[RissSample, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)

    def draw(size: float) -> torch.Tensor:
        return size * torch.randn(n, generator=g, dtype=torch.float64)

    one = torch.ones(n, dtype=torch.float64)
    speed = 12.0 + torch.linspace(0.0, 1.5, n, dtype=torch.float64)
    samples = RissSample(
        0.02 * one,
        0.3 + draw(0.05),
        speed,
        0.05 + draw(0.002),
        0.03 * one,
        draw(1.0),
        draw(1.0),
        0.0 * one,
    )
    return samples, 1.5 * one


def belief_of(options: EkfOptions) -> Belief:
    lat = torch.tensor(0.8, dtype=torch.float64)
    state = NavState(lat, 0.1 + 0.0 * lat, 200.0 + 0.0 * lat, 0.7 + 0.0 * lat)
    known = {
        "gyro_bias": 0.01,
        "speed_scale": 0.03,
        "speed_delay": 0.05,
        "speed_offset": 0.1,
        "pitch_bias": 0.02,
    }
    belief = initial_belief(options, state, sensor=known)
    return belief._replace(anchor=0.5 * belief.anchor)


def occasion_at(belief: Belief, samples: RissSample, push: torch.Tensor, still: bool) -> Occasion:
    zero = torch.zeros_like(belief.state.lat)
    one = zero + 1.0
    at = belief.state
    fix = GnssFix(
        at.lat + 3e-7,
        at.lon - 2e-7,
        at.height + 1.0,
        zero + 7.0,
        zero + 9.0,
        zero + 0.5,
        one,
        one,
        2.0 * one,
        0.1 * one,
        one,
        one,
    )
    last = RissSample(*(x[..., -1] for x in samples))
    rest = Rest(zero, zero, torch.zeros(0), zero)
    if still:
        last = last._replace(speed=zero, stationary=one)
    return Occasion(fix, zero + 0.03, BlockEnd(last, push[..., -1]), rest)


@pytest.mark.parametrize("name", MODELS)
def test_transition_is_the_derivative_of_the_mechanization(name):
    options = MODELS[name]
    model, belief = filter_model(options), belief_of(options)
    samples, push = block()
    noise = noise_from_log(log_noise(NoiseOptions()))
    start_end = BlockEnd(RissSample(*(x[..., 0] for x in samples)), push[..., 0])
    last_end = BlockEnd(RissSample(*(x[..., -1] for x in samples)), push[..., -1])
    still = predict_blocks(model, belief, samples, push, noise)
    middle = belief._replace(
        state=still.state, sensor=still.sensor, velocity_offset=still.velocity_offset
    )

    def moved(correction):
        begin = fed_back(model, belief, correction, start_end)
        ahead = predict_blocks(model, begin, samples, push, noise)
        end = belief._replace(
            state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
        )
        return -difference(model, middle, end, last_end)

    n = model.layout.size
    automatic = torch.func.jacrev(moved)(torch.zeros(n, dtype=torch.float64))
    analytic = still.linearised.transition
    # velocity errors of the Shen models turn with differences of the odometer, not with its path
    limit = 0.05 if model.layout.has_velocity else 2e-4
    scale = automatic.abs().amax(1, keepdim=True).clamp(min=1.0)
    torch.testing.assert_close(analytic / scale, automatic / scale, atol=limit, rtol=limit)


@pytest.mark.parametrize("still", [False, True])
@pytest.mark.parametrize("name", MODELS)
def test_observation_is_the_derivative_of_the_prediction(name, still):
    options = MODELS[name]
    model, belief = filter_model(options), belief_of(options)
    samples, push = block()
    occasion = occasion_at(belief, samples, push, still)
    if model.layout.has_velocity:
        occasion = occasion._replace(delay=0.0 * occasion.delay)
    count = len(model.errors.gyro_terms)
    regressors = torch.linspace(1.0, 2.0, count, dtype=torch.float64)
    one = torch.ones_like(belief.state.lat)
    occasion = occasion._replace(rest=Rest(one, 0.01 * one, regressors, one))
    noise = noise_from_log(log_noise(NoiseOptions()))

    def predicted(correction):
        at = fed_back(model, belief, correction, occasion.end)
        return -measured(model.measurement, at, occasion, noise).innovation

    zero = torch.zeros(model.layout.size, dtype=torch.float64)
    automatic = torch.func.jacrev(predicted)(zero)
    analytic = measured(model.measurement, belief, occasion, noise).observation
    torch.testing.assert_close(analytic, automatic, atol=2e-4, rtol=1e-4)


def test_block_noise_equals_a_sum_over_samples():
    options = EkfOptions(gyro_terms=("bias", "scale"))
    model, belief = filter_model(options), belief_of(options)
    samples, push = block(n=40)
    noise = noise_from_log(log_noise(NoiseOptions(gyro_bias_walk=1e-3, speed_scale_walk=1e-2)))
    ahead = predict_blocks(model, belief, samples, push, noise)
    total = torch.zeros_like(ahead.linearised.noise)
    part = belief
    for k in range(40):
        one = RissSample(*(x[k : k + 1] for x in samples))
        step = predict_blocks(model, part, one, push[k : k + 1], noise)
        F = step.linearised.transition
        total = F @ total @ F.T + step.linearised.noise
        part = part._replace(state=step.state, sensor=step.sensor)
    sigma = total.diagonal().sqrt().clamp(min=1e-12)
    gap = (ahead.linearised.noise - total) / (sigma[:, None] * sigma)
    assert float(gap.abs().max()) < 0.05
    assert float(torch.linalg.eigvalsh(ahead.linearised.noise).min()) > -1e-12


def test_a_block_moves_as_the_mechanization_does():
    options = EkfOptions()
    model, belief = filter_model(options), belief_of(options)
    samples, push = block()
    moved = move_block(
        model.errors, belief.state, belief.sensor, belief.anchor, samples, push, model.earth_rate
    )
    path = riss_over_time(
        belief.state,
        samples,
        gyro_bias=belief.sensor[0],
        odometer_scale=belief.sensor[1],
        pitch_bias=belief.sensor[2],
    )
    end = NavState(*(x[-1] for x in path[:4]))
    assert float(position_difference(moved.end, end).abs().max()) < 1e-6
    assert float((moved.end.azimuth - end.azimuth).abs()) < 1e-11


def test_rest_is_the_mean_over_the_stationary_tail():
    samples, _ = block(n=10)
    still = torch.zeros(10, dtype=torch.float64)
    still[[1, 6, 7, 8, 9]] = 1.0
    dt = samples.dt.clone()
    dt[9] = 0.0
    model = filter_model(EkfOptions(gyro_terms=("bias", "scale")))
    rows = RissSample(*(channel[None] for channel in samples._replace(stationary=still, dt=dt)))
    rest = rest_at_end(model.errors, rows)
    assert float(rest.duration) == pytest.approx(0.06)
    mean = float(samples.yaw_rate[6:9].mean())
    assert float(rest.yaw_rate) == pytest.approx(mean)
    torch.testing.assert_close(rest.regressors, torch.tensor([[1.0, mean]], dtype=torch.float64))


def test_zero_yaw_rate_knows_the_earth_rate():
    options = EkfOptions()
    model, belief = filter_model(options), belief_of(options)
    samples, push = block()
    occasion = occasion_at(belief, samples, push, still=True)
    one = torch.ones_like(belief.state.lat)
    told = 0.01 + 7.292115e-5 * math.sin(0.8)
    occasion = occasion._replace(rest=Rest(one, told * one, one.unsqueeze(-1), one))
    noise = noise_from_log(log_noise(NoiseOptions()))
    found = measured(model.measurement, belief, occasion, noise)
    assert float(found.innovation[-1]) == pytest.approx(0.0, abs=1e-15)


def test_blocks_end_at_fixes_and_are_never_long():
    g = torch.Generator().manual_seed(0)
    dt = 0.01 + 0.005 * torch.rand(2, 3000, generator=g, dtype=torch.float64)
    index = torch.tensor([[0, 99, 99, 700, 1500, -1], [-1, 5, 6, 7, 2999, -1]])
    blocks = cut(dt, index, 1.0)
    time = torch.cumsum(dt, 1)
    for b in range(2):
        places = blocks.gather[b][blocks.used[b] > 0]
        assert torch.equal(places, torch.arange(3000))
        durations = (dt[b][blocks.gather[b]] * blocks.used[b]).sum(1)
        assert float(durations.max()) <= 1.27
        chosen = blocks.fix[b] >= 0
        assert torch.equal(blocks.end[b][chosen], index[b][index[b] >= 0])
        assert torch.equal(blocks.fix[b][chosen], (index[b] >= 0).nonzero()[:, 0])
        assert int(blocks.end[b, -1]) == 2999
    assert float(time[0, -1]) > 30.0
