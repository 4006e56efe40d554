"""What each kind of measurement does, and the gate before it."""

import math

import pytest
import torch

from navlearn.attitude import (
    angles_from_matrix,
    matrix_from_angles,
    matrix_from_quaternion,
    quaternion_from_angles,
    quaternion_multiply,
)
from navlearn.frames import shift_geodetic
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import ins_layout, moved_belief, state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.model import ins_filter_model
from navlearn.fusion.ins.moment import moment_of
from navlearn.fusion.ins.options import InsEkfOptions, InsNoiseOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.ins.wheels import axle_velocity
from navlearn.fusion.measurements import Verdict
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

ALONE = {
    "position": False,
    "velocity": False,
    "odometer": False,
    "nonholonomic": False,
    "zero_velocity": False,
    "zero_angular_rate": False,
}


def run(options, d, belief=None, method="exact"):
    with torch.no_grad():
        start = initial_ins_belief(options, d.start) if belief is None else belief
        return InsEkf(options)(start, d.samples, d.fixes, d.timing, method=method)


def deviations(options, history):
    names = ins_layout(options).names
    last = history.belief.covariance[-1].diagonal().sqrt()
    return dict(zip(names, last.tolist(), strict=True))


@pytest.mark.parametrize("kind", ALONE)
def test_each_kind_alone_makes_surer(make_clean, lever_arm, kind):
    d = make_clean(25.0, 25)
    options = [
        InsEkfOptions(**{**ALONE, kind: use}, lever_arm=lever_arm, odometer_scale=False)
        for use in (False, True)
    ]
    without, having = (deviations(o, run(o, d)) for o in options)
    better = {
        "position": ("east", "v_north", "phi_east"),
        "velocity": ("v_east", "phi_north", "accel_bias_z"),
        "odometer": ("v_north",),
        "nonholonomic": ("v_east", "v_up"),
        "zero_velocity": ("phi_east", "gyro_bias_x"),
        "zero_angular_rate": ("gyro_bias_x", "gyro_bias_z"),
    }[kind]
    for name in better:
        assert having[name] < 0.8 * without[name], name
    for name in having:
        assert having[name] < 1.0001 * without[name], name


@pytest.mark.parametrize("kind", ["odometer", "nonholonomic", "velocity", "position"])
def test_each_kind_alone_pulls_towards_the_truth(make_clean, lever_arm, kind):
    d = make_clean(25.0, 25)
    options = InsEkfOptions(**{**ALONE, kind: True}, lever_arm=lever_arm, odometer_scale=False)
    belief = initial_ins_belief(options, d.start)
    wrong = torch.zeros(options.states, dtype=torch.float64)
    wrong[[3, 4]] = torch.tensor([0.4, -0.3], dtype=torch.float64)
    belief = moved_belief(belief, wrong)
    # the car moves from the fifth second on; errors of a car at rest are not aided by the axle
    error = state_difference(run(options, d, belief).trajectory, d.truth)[-1]
    free = state_difference(
        run(InsEkfOptions(**ALONE, odometer_scale=False), d, belief).trajectory, d.truth
    )[-1]
    assert float(error[3:5].norm()) < 0.5 * float(free[3:5].norm())


def test_odometer_tells_its_own_scale(make_clean, lever_arm):
    d = make_clean(60.0, 25)
    d = d._replace(samples=d.samples._replace(speed=1.03 * d.samples.speed))
    options = InsEkfOptions(lever_arm=lever_arm)
    history = run(options, d)
    assert float(history.belief.sensor[-1, -1]) == pytest.approx(0.03, abs=0.002)


def test_a_silent_odometer_says_nothing(make_clean, lever_arm):
    d = make_clean(25.0, 25)
    silent = d._replace(samples=d.samples._replace(has_speed=0.0 * d.samples.has_speed))
    history = run(InsEkfOptions(lever_arm=lever_arm), silent)
    assert bool((history.verdict[:, InsKind.ODOMETER] == Verdict.ABSENT).all())
    assert bool((history.verdict[:, InsKind.NONHOLONOMIC] == Verdict.ACCEPTED).all())


def test_a_mounted_imu_is_turned_into_the_car(make_clean):
    d = make_clean(40.0, 25)
    turned = (0.2, 0.1, -0.15)
    # what an IMU tells that looks right, up and rolled: its axes against the car's
    angles = torch.tensor(turned, dtype=torch.float64).unbind()
    C_vb = matrix_from_angles(*angles)
    samples = d.samples._replace(omega_ib_b=d.samples.omega_ib_b @ C_vb, f_b=d.samples.f_b @ C_vb)
    q_vb = quaternion_from_angles(*angles)
    start = d.start._replace(q_lb=quaternion_multiply(d.start.q_lb, q_vb))
    d = d._replace(samples=samples, start=start)
    choices = {**ALONE, "odometer": True, "nonholonomic": True}
    right = run(InsEkfOptions(**choices, mounting=turned, odometer_scale=False), d)
    assert float(right.innovation.nan_to_num().abs().max()) < 0.01
    wrong = run(
        InsEkfOptions(**choices, odometer_scale=False, gate=GateOptions(probability=1.0)), d
    )
    assert float(wrong.innovation.nan_to_num().abs().max()) > 0.5


def test_the_rear_axle_moves_as_the_imu_turns(make_clean):
    """An IMU two metres ahead of the axle swings sideways in every turn."""
    d = make_clean(60.0, 25)
    arm = torch.tensor([0.0, 2.0, 0.5], dtype=torch.float64)
    C = matrix_from_quaternion(d.truth.q_lb)
    rate = d.samples.omega_ib_b
    swing = (C @ torch.linalg.cross(rate, arm.expand_as(rate)).unsqueeze(-1)).squeeze(-1)
    options = InsEkfOptions(**{**ALONE, "nonholonomic": True}, wheel_lever_arm=(0.0, -2.0, -0.5))
    model = ins_filter_model(options)
    ahead = d.truth._replace(v_l=d.truth.v_l + swing)
    belief = initial_ins_belief(options, ahead)
    now = moment_of(model, belief, d.samples)
    sideways = axle_velocity(model, belief, now, 0.0 * d.samples.dt).velocity[:, 0]
    unaware = (C.transpose(-1, -2) @ ahead.v_l.unsqueeze(-1)).squeeze(-1)[:, 0]
    assert float(unaware.abs().max()) > 0.3
    assert float(sideways.abs().max()) < 0.02


def test_standstill_holds_a_car_through_an_outage(make_drive):
    d = make_drive(seconds=6, rate=25)
    still = ImuSample(*(x[:120] for x in d.samples))  # 4.8 of the 5 s that it stands
    many = ImuSample(*(torch.cat((x,) * 5) for x in still))
    none = d._replace(
        samples=many,
        fixes=GnssFix(*(x[:0] for x in d.fixes)),
        timing=FixTiming(*(x[:0] for x in d.timing)),
    )
    held, free = (
        run(InsEkfOptions(zero_velocity=use, nonholonomic=False, odometer=False), none)
        for use in (True, False)
    )
    start = InsState(*(x.expand(600, *x.shape) for x in d.start))
    drift = [state_difference(h.trajectory, start)[-1, :3].norm() for h in (held, free)]
    assert float(drift[0]) < 0.3
    assert float(drift[1]) > 3.0
    told = held.belief.sensor[-1, :3]
    assert float((told - torch.tensor([0.001, -0.002, 0.0015]).double()).abs().max()) < 3e-5


def test_odometer_and_axle_keep_their_interval(make_clean, lever_arm):
    d = make_clean(25.0, 25)
    often = InsEkfOptions(lever_arm=lever_arm, max_block=0.2, aiding_interval=0.0)
    seldom = InsEkfOptions(lever_arm=lever_arm, max_block=0.2, aiding_interval=2.0)
    used = [
        int((run(o, d).verdict[:, InsKind.NONHOLONOMIC] != Verdict.ABSENT).sum())
        for o in (often, seldom)
    ]
    assert used[0] == 125
    assert 11 <= used[1] <= 13


@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_a_wild_fix_is_refused(make_drive, lever_arm, method):
    d = make_drive(seconds=14, rate=10)
    lat, lon, height = (x.clone() for x in d.fixes[:3])
    lat[8], lon[8], height[8] = shift_geodetic(
        lat[8], lon[8], height[8], *torch.tensor([60.0, -40.0, 0.0]).double()
    )
    wild = d._replace(fixes=d.fixes._replace(lat=lat, lon=lon))
    options = InsEkfOptions(lever_arm=lever_arm)
    good, bad = run(options, d, method=method), run(options, wild, method=method)
    block = int((bad.fix == 8).nonzero()[0])
    assert int(bad.verdict[block, InsKind.POSITION]) == Verdict.REFUSED_BY_GATE
    assert int(bad.verdict[block, InsKind.VELOCITY]) == Verdict.ACCEPTED
    assert float(bad.belief.refused[block, InsKind.POSITION]) == 1.0
    assert float(bad.belief.refused[-1, InsKind.POSITION]) == 0.0
    gap = state_difference(bad.trajectory, good.trajectory)[-1, :3]
    assert float(gap.norm()) < 1.0


def test_a_filter_that_is_lost_comes_back(make_drive, lever_arm):
    d = make_drive(seconds=30, rate=25)
    options = InsEkfOptions(lever_arm=lever_arm, gate=GateOptions(reset_after=4))
    belief = initial_ins_belief(options, d.start, sigmas={"position": 0.5, "height": 0.5})
    wrong = torch.zeros(16, dtype=torch.float64)
    wrong[:2] = torch.tensor([200.0, -100.0])
    history = run(options, d, moved_belief(belief, wrong))
    verdict = history.verdict[:, InsKind.POSITION].tolist()
    assert verdict[:5] == [Verdict.REFUSED_BY_GATE] * 4 + [Verdict.ACCEPTED_BY_RESET]
    assert int(history.resets[InsKind.POSITION]) == 1
    error = state_difference(history.trajectory, d.truth)
    assert float(error[100, :2].norm()) > 200.0
    assert float(error[-1, :2].norm()) < 3.0


def test_open_and_closed_loop_agree_to_first_order(make_clean, lever_arm):
    d = make_clean(20.0, 25)
    unit = torch.tensor([1.0, -1, 0.5, 0.2, 0.1, 0, 0.004, -0.003, 0.01]).double()
    bias = torch.tensor([0.001, -0.002, 0.0015]).double()
    found = []
    for size in (0.2, 0.1):
        wrong = torch.nn.functional.pad(size * unit, (0, 7))
        samples = d.samples._replace(omega_ib_b=d.samples.omega_ib_b + size * bias)
        ends = []
        for feedback in ("open", "closed"):
            options = InsEkfOptions(
                feedback=feedback, lever_arm=lever_arm, gate=GateOptions(probability=1.0)
            )
            belief = moved_belief(initial_ins_belief(options, d.start), wrong)
            ends.append(run(options, d._replace(samples=samples), belief))
        gap = state_difference(ends[0].belief.state, ends[1].belief.state)[-1]
        found.append((float(gap[:3].norm()), float(gap[6:].norm())))
        assert float(ends[1].error.abs().max()) == 0.0
        # the free mechanization has gone astray, and the estimate of its error says so
        assert float(ends[0].error[-1, :3].norm()) > 10.0 * found[-1][0]
        assert float(ends[0].error[-1, :3].norm()) > 0.1
    # what is left is of second order: half the errors leave a quarter of it
    for whole, half in zip(*found, strict=True):
        assert half < 0.35 * whole


def test_azimuth_error_is_minus_phi_up(make_clean):
    d = make_clean(25.0, 25)
    options = InsEkfOptions()
    belief = initial_ins_belief(options, d.start)
    wrong = torch.zeros(16, dtype=torch.float64)
    wrong[8] = -0.01
    moved = moved_belief(belief, wrong)
    azimuths = [
        float(angles_from_matrix(matrix_from_quaternion(b.state.q_lb))[0]) for b in (moved, belief)
    ]
    assert azimuths[0] - azimuths[1] == pytest.approx(0.01, abs=1e-6)


def test_noise_at_rest_grows_as_stated(make_clean):
    """Without any aid, white gyro noise becomes σ √t of attitude."""
    d = make_clean(25.0, 25)
    quiet = InsNoiseOptions(gyro_random_walk=1e-3, turn_noise=0.0, gyro_bias_walk=0.0)
    options = InsEkfOptions(**ALONE, noise=quiet, odometer_scale=False)
    belief = initial_ins_belief(options, d.start, sigmas={"azimuth": 1e-9, "gyro_bias": 1e-12})
    history = run(options, d, belief)
    sigma = math.sqrt(float(history.belief.covariance[-1, 8, 8]))
    assert sigma == pytest.approx(1e-3 * math.sqrt(25.0), rel=1e-2)
