"""Every analytic derivative of the full-IMU filter against automatic ones."""

import math

import pytest
import torch

from navlearn.attitude import matrix_from_quaternion, quaternion_from_angles
from navlearn.filters.discretize import van_loan
from navlearn.frames import shift_geodetic
from navlearn.fusion.ins.composed import by_preintegration, by_product
from navlearn.fusion.ins.dahmane2022 import VERTICAL_TIME
from navlearn.fusion.ins.error_dynamics import Motion, gravity_gradient, motion_between
from navlearn.fusion.ins.layout import (
    imu_corrected,
    imu_errors,
    moved_belief,
    moved_state,
    state_difference,
)
from navlearn.fusion.ins.linear_steps import discretized
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.model import diffusion, dynamics, ins_filter_model
from navlearn.fusion.ins.noise import ins_noise_from_log, log_ins_noise
from navlearn.fusion.ins.options import InsEkfOptions, InsNoiseOptions
from navlearn.fusion.ins.path import path_over_samples
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.ins.timeline import InsOccasion, InsRest
from navlearn.fusion.ins.updates import ins_measured
from navlearn.mechanization.coning import coning_sculling_step
from navlearn.mechanization.strapdown import local_level_step
from navlearn.states import GnssFix, ImuSample, InsState

NOISE = ins_noise_from_log(log_ins_noise(InsNoiseOptions()))


def vector(*values):
    return torch.tensor(values, dtype=torch.float64)


def fast_state():
    """At 60° of latitude and 100 m/s, so that what is small shows."""
    lat, lon, height = vector(1.05, 0.3, 500.0).unbind()
    attitude = quaternion_from_angles(*vector(0.7, 0.1, -0.05).unbind())
    return InsState(lat, lon, height, vector(60.0, 80.0, 3.0), attitude)


def belief_of(options):
    sensor = {
        "gyro_bias": vector(0.01, -0.02, 0.03),
        "accel_bias": vector(0.1, 0.2, -0.3),
        "gyro_scale": vector(0.01, 0.02, -0.01),
        "accel_scale": vector(0.004, -0.003, 0.002),
        "odometer_scale": 0.02,
    }
    return initial_ins_belief(options, fast_state(), sensor=sensor)


def step_of(model, omega, force, dt):
    def step(state, sensor):
        rate, push = imu_corrected(imu_errors(model.layout, sensor), omega, force)
        turn, speed = coning_sculling_step(rate, push, dt)
        return local_level_step(state, turn, speed, dt), rate, push

    return step


def gap_per_second(options, dt=0.001):
    """Derivative of one strapdown step minus the transition by F, per second, (9, n)."""
    model, belief = ins_filter_model(options), belief_of(options)
    n = model.layout.size
    h = vector(dt)[0]
    step = step_of(model, vector(0.05, -0.03, 0.3), vector(2.0, 1.5, 9.9), h)
    end, rate, push = step(belief.state, belief.sensor)

    def moved(error):
        new = step(moved_state(belief.state, error), belief.sensor + error[9:])[0]
        return state_difference(new, end)

    automatic = torch.func.jacrev(moved)(torch.zeros(n, dtype=torch.float64))
    F = dynamics(
        model,
        motion_between(belief.state, end, rate, push),
        imu_errors(model.layout, belief.sensor),
    )
    transition, _ = discretized(F, torch.zeros(n, dtype=torch.float64), h)
    return (automatic - transition[:9]) / h


@pytest.mark.parametrize("states", [9, 15, 21])
def test_dynamics_are_the_derivative_of_the_strapdown(states):
    gap = gap_per_second(InsEkfOptions(states=states))
    # what the curvature's own change and gravity's change to the north do is left out
    assert float(gap[:, :3].abs().max()) < 5e-7
    assert float(gap[3:, 1].abs().max()) < 1.2e-8
    assert float(gap[:, 3:9].abs().max()) < 5e-8
    if states > 9:
        assert float(gap[:, 9:].abs().max()) < 2e-6


def test_simplified_dynamics_lack_only_the_transport_rate():
    options = {"states": 15, "odometer": False}
    gap = gap_per_second(InsEkfOptions(model="dahmane2022", **options)).abs()
    limit = 5e-5  # about v tan φ / R
    assert float(gap.max()) < limit
    # and it is another model than the complete one
    assert float(gap[3:6, 3:6].max()) > 1e-6
    assert 569.0 < VERTICAL_TIME < 571.0


def test_coriolis_turns_no_velocity_into_energy():
    options = InsEkfOptions(model="dahmane2022", states=9, odometer=False)
    state = fast_state()
    still = Motion(
        state.lat,
        state.height,
        state.v_l,
        torch.eye(3).double(),
        vector(0, 0, 0),
        vector(0, 0, 9.8),
    )
    model = ins_filter_model(options)
    F = dynamics(model, still, imu_errors(model.layout, vector()))
    torch.testing.assert_close(F[3:6, 3:6], -F[3:6, 3:6].T)
    assert float(F[3, 4]) == pytest.approx(2.0 * 7.292115e-5 * math.sin(1.05))
    # level and at rest: forward velocity is changed by g times a tilt about east
    assert float(F[4, 6]) == pytest.approx(-9.8)
    assert float(F[3, 7]) == pytest.approx(9.8)


def test_height_falls_away_by_twice_gravity_over_radius():
    lat, height = vector(0.8, 100.0).unbind()
    expected = 2.0 * 9.81 / 6.371e6
    assert float(gravity_gradient(lat, height)) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("model", ["phi_angle", "dahmane2022"])
def test_discretisation_is_that_of_van_loan(model):
    options = InsEkfOptions(states=21, model=model)
    made, belief = ins_filter_model(options), belief_of(options)
    state, rate = belief.state, vector(0.05, -0.03, 0.3)
    motion = motion_between(state, state, rate, vector(2.0, 1.5, 9.9))
    F = dynamics(made, motion, imu_errors(made.layout, belief.sensor))
    density = diffusion(made.layout, rate, NOISE)
    h = vector(0.01)[0]
    transition, noise = discretized(F, density, h)
    exact, wanted = van_loan(F, torch.diag_embed(density), h)
    scale = wanted.diagonal().sqrt()
    assert float((transition - exact).abs().max()) < 2e-6
    gap = ((noise - wanted) / (scale[:, None] * scale)).abs()
    # the noise of position comes from that of velocity alone: a third, not a half
    assert float(gap[3:, 3:].max()) < 5e-4
    assert bool((noise.diagonal() >= 0.999 * wanted.diagonal()).all())


def block(n=50):
    g = torch.Generator().manual_seed(3)
    one = torch.ones(n, dtype=torch.float64)

    def around(*mean):
        return vector(*mean) + 0.3 * torch.randn(n, 3, generator=g, dtype=torch.float64)

    return ImuSample(
        0.02 * one, 0.3 * around(0.1, 0.0, 1.0), around(2.0, 1.5, 9.9), one, one, 0.0 * one
    )


SCALES = [1.0] * 3 + [0.1] * 3 + [1e-3] * 3 + [1e-4] * 3 + [1e-2] * 3 + [1e-3] * 6 + [0.01]


@pytest.mark.parametrize("compose", [by_preintegration, by_product])
def test_block_transition_is_the_derivative_of_the_path(compose):
    options = InsEkfOptions(states=21)
    model, belief = ins_filter_model(options), belief_of(options)
    samples = block()
    _, transition, _ = compose(model, belief, samples, NOISE)

    def end_of(error):
        path = path_over_samples(model, moved_belief(belief, error), samples)
        return InsState(*(x[-1] for x in path))

    n = model.layout.size
    zero = torch.zeros(n, dtype=torch.float64)
    end = end_of(zero)
    automatic = torch.func.jacrev(lambda e: state_difference(end_of(e), end))(zero)
    scale = vector(*SCALES)
    gap = (transition[:9] - automatic) * scale / scale[:9, None]
    assert float(gap.abs().max()) < 3e-3
    assert float(gap[:, :9].abs().max()) < 2e-4


def test_noise_of_a_block_is_the_same_by_both_ways():
    options = InsEkfOptions(states=21)
    model, belief = ins_filter_model(options), belief_of(options)
    _, _, one = by_preintegration(model, belief, block(), NOISE)
    _, _, other = by_product(model, belief, block(), NOISE)
    scale = other.diagonal().sqrt()
    gap = (one - other) / (scale[:, None] * scale)
    assert float(gap.abs().max()) < 0.02
    assert float(torch.linalg.eigvalsh(one / (scale[:, None] * scale)).min()) > 0.0


def occasion_at(state, delay):
    zero, one = torch.zeros_like(state.lat), torch.ones_like(state.lat)
    fix = GnssFix(
        state.lat + 3e-7, state.lon - 2e-7, state.height + 1.0,
        zero + 50.0, zero + 70.0, zero + 2.0, one, one, 2.0 * one, 0.1 * one, one, one,
    )  # fmt: skip
    last = ImuSample(
        0.02 * one, vector(0.05, -0.1, 0.4), vector(2.0, 1.5, 9.9), 99.0 * one, one, one
    )
    rest = InsRest(one, vector(0.01, -0.02, 0.03), one)
    return InsOccasion(fix, zero + delay, last, rest, one)


MEASURED = {
    "plain": {},
    "arms": {
        "lever_arm": (0.5, -1.2, 1.7),
        "wheel_lever_arm": (0.1, -1.5, -0.6),
        "mounting": (0.05, -0.1, 0.2),
    },
    "flat": {"vertical_velocity": False, "odometer_scale": False},
}


@pytest.mark.parametrize("delay", [0.0, 0.2])
@pytest.mark.parametrize("states", [9, 15, 21])
@pytest.mark.parametrize("name", MEASURED)
def test_observation_is_the_derivative_of_the_prediction(name, states, delay):
    options = InsEkfOptions(states=states, **MEASURED[name])
    model, belief = ins_filter_model(options), belief_of(options)
    occasion = occasion_at(belief.state, delay)

    def predicted(error):
        return -ins_measured(model, moved_belief(belief, error), occasion, NOISE).innovation

    found = ins_measured(model, belief, occasion, NOISE)
    automatic = torch.func.jacrev(predicted)(torch.zeros(model.layout.size, dtype=torch.float64))
    torch.testing.assert_close(found.observation, automatic, atol=1e-6, rtol=1e-5)
    assert bool((found.present[list(model.rows.kinds)] == 1.0).all())


def test_a_late_fix_is_where_the_car_was():
    options = InsEkfOptions(lever_arm=(0.5, -1.2, 1.7), odometer=False)
    model, belief = ins_filter_model(options), belief_of(options)
    samples = block(20)
    path = path_over_samples(model, belief._replace(sensor=belief.sensor), samples)
    now = belief._replace(state=InsState(*(x[-1] for x in path)))
    last = ImuSample(*(x[-1] for x in samples))
    turned = imu_corrected(imu_errors(model.layout, belief.sensor), last.omega_ib_b, last.f_b)
    at = path_over_samples(
        model, now, ImuSample(-0.1 * torch.ones(1).double(), *(x[None] for x in last[1:]))
    )
    there = InsState(*(x[-1] for x in at))
    arm = vector(0.5, -1.2, 1.7)
    C = matrix_from_quaternion(there.q_lb)
    lat, lon, height = shift_geodetic(*there[:3], *(C @ arm).unbind())
    speed = there.v_l + C @ torch.linalg.cross(turned[0], arm)
    one = torch.ones_like(lat)
    fix = GnssFix(lat, lon, height, *speed.unbind(), *(one,) * 6)
    zero = 0.0 * one
    rest = InsRest(zero, 0.0 * arm, zero)
    found = ins_measured(model, now, InsOccasion(fix, 0.1 * one, last, rest, zero), NOISE)
    rows = [model.rows.of(kind) for kind in (InsKind.POSITION, InsKind.VELOCITY)]
    # half a tenth of a second of turning by 0.3 rad/s is what a straight line cannot know
    assert float(found.innovation[rows[0]].abs().max()) < 0.01
    assert float(found.innovation[rows[1]].abs().max()) < 0.1
