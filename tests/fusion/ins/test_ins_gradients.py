"""Gradients through the full-IMU filter."""

import pytest
import torch

from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState


def few(d, samples=6, fixes=(2, 5)):
    """The middle of a drive: a few samples, with fixes at some of them."""
    first = len(d.samples.dt) - samples
    index = torch.tensor(fixes)
    take = [int((d.timing.index <= first + k).sum()) - 1 for k in fixes]
    begin = InsState(*(x[first - 1] for x in d.truth))
    return d._replace(
        start=begin,
        samples=ImuSample(*(x[first:] for x in d.samples)),
        fixes=GnssFix(*(x[take] for x in d.fixes)),
        timing=FixTiming(index, torch.zeros(len(fixes), dtype=torch.float64)),
    )


def end_of(options, d, method):
    ekf = InsEkf(options)
    belief = initial_ins_belief(options, d.start)

    def end(omega, force, velocity, sensor, speed_of_fix, log_noise):
        samples = d.samples._replace(omega_ib_b=omega, f_b=force)
        start = belief._replace(state=belief.state._replace(v_l=velocity), sensor=sensor)
        fixes = d.fixes._replace(v_e=speed_of_fix)
        history = torch.func.functional_call(
            ekf, {"log_noise": log_noise}, (start, samples, fixes, d.timing), {"method": method}
        )
        last = InsState(*(x[-1] for x in history.trajectory))
        middle = InsState(*(x[2] for x in history.trajectory))
        spread = history.belief.covariance[-1].diagonal().log()
        both = torch.cat((state_difference(last, d.start), state_difference(middle, d.start)))
        return both, 0.01 * spread

    inputs = (
        d.samples.omega_ib_b,
        d.samples.f_b,
        d.start.v_l,
        belief.sensor,
        d.fixes.v_e,
        ekf.log_noise.detach(),
    )
    return end, tuple(x.clone().requires_grad_() for x in inputs)


@pytest.mark.parametrize("method", ["exact", "sequential"])
@pytest.mark.parametrize("choice", ["default", "scale", "open", "dahmane2022"])
def test_gradcheck_through_the_filter(make_drive, lever_arm, method, choice):
    more = {
        "default": {},
        "scale": {"states": 21},
        "open": {"feedback": "open"},
        "dahmane2022": {"model": "dahmane2022"},
    }[choice]
    d = few(make_drive(seconds=20, rate=25))
    options = InsEkfOptions(
        lever_arm=lever_arm, gate=GateOptions(probability=1.0), max_block=0.2, **more
    )
    end, inputs = end_of(options, d, method)
    assert torch.autograd.gradcheck(
        end, inputs, eps=1e-5, atol=1e-4, rtol=1e-3, fast_mode=True, nondet_tol=0.0
    )


def test_noise_can_be_learned_through_the_filter(make_drive, lever_arm):
    d = make_drive(seconds=20, rate=25)
    ekf = InsEkf(InsEkfOptions(lever_arm=lever_arm))
    ekf.log_noise.requires_grad_(True)
    history = ekf(initial_ins_belief(ekf.options, d.start), d.samples, d.fixes, d.timing)
    (gradient,) = torch.autograd.grad(history.nis.nansum(), ekf.log_noise)
    assert bool(torch.isfinite(gradient).all())
    # larger measurement noise explains innovations away
    for name in ("position_floor", "velocity_floor", "odometer_noise"):
        assert float(gradient[ekf.noise._fields.index(name)]) < 0.0


def test_gradients_of_both_forms_agree(make_drive):
    d = make_drive(seconds=8, rate=10)
    options = InsEkfOptions(gate=GateOptions(probability=1.0))
    found = []
    for method in ("exact", "sequential"):
        ekf, force = InsEkf(options), d.samples.f_b.clone().requires_grad_()
        history = ekf(
            initial_ins_belief(options, d.start),
            d.samples._replace(f_b=force),
            d.fixes,
            d.timing,
            method=method,
        )
        loss = history.trajectory.v_l.square().sum() + history.nis.nansum()
        found.append(torch.autograd.grad(loss, force)[0])
    assert float((found[0] - found[1]).norm() / found[1].norm()) < 1e-3
