"""Thresholds and weights in front of the full-IMU filter, whose position is an anchor."""

import pytest
import torch

from navlearn.errors import ConfigError
from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.smoothing import smooth_ins
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.measurements import Verdict, refused
from navlearn.fusion.motion_watch import MotionWatch
from navlearn.fusion.smoothed_blocks import SmoothingOptions
from navlearn.states import GnssFix, ImuSample

pytestmark = pytest.mark.filterwarnings("ignore:filter. :UserWarning")
BY_PREDICTION, BY_MOTION = int(Verdict.REFUSED_BY_PREDICTION), int(Verdict.REFUSED_BY_MOTION)
GATES = {
    "thresholds": GateOptions(prediction_limit=12.0, motion_limit=6.0, reset_after=4),
    "motion": GateOptions(motion_limit=6.0, reset_after=4),
    "huber": GateOptions(robust="huber", probability=1.0 - 1e-9, reset_after=4),
    "student": GateOptions(robust="student", probability=1.0),
    "all": GateOptions(robust="huber", prediction_limit=30.0, motion_limit=15.0, reset_after=5),
}


def spoiled(d):
    east, north = torch.zeros_like(d.fixes.lat), torch.zeros_like(d.fixes.lat)
    east[..., 14], north[..., 22:31] = 40.0, 25.0
    lat, lon, height = shift_geodetic(*d.fixes[:3], east, north, 0.0 * east)
    return d._replace(fixes=d.fixes._replace(lat=lat, lon=lon, height=height))


def run(options, d, method="exact"):
    belief = initial_ins_belief(options, d.start)
    with torch.no_grad():
        return InsEkf(options)(belief, d.samples, d.fixes, d.timing, method=method)


def of_fixes(history):
    return history.verdict[history.fix >= 0][:, InsKind.POSITION].tolist()


@pytest.mark.parametrize("name", GATES)
def test_all_forms_believe_the_same(make_drive, lever_arm, name):
    d = spoiled(make_drive(seconds=33, rate=20))
    options = InsEkfOptions(lever_arm=lever_arm, gate=GATES[name])
    # sample by sample is slow: the gates that have everything stand for the others
    methods = ("exact", "fast", *(("sequential",) if name in ("all", "student") else ()))
    exact, *others = (run(options, d, m) for m in methods)
    assert tuple(one.method for one in (exact, *others)) == methods
    said = of_fixes(exact)
    assert said[14] != int(Verdict.ACCEPTED)
    assert said[22] != int(Verdict.ACCEPTED)
    for other in others:
        assert torch.equal(other.verdict, exact.verdict)
        assert torch.equal(other.belief.refused, exact.belief.refused)
        gap = state_difference(other.trajectory, exact.trajectory).abs()
        assert float(gap[..., :3].max()) < (1e-3 if other.method == "fast" else 0.1)


def test_reasons_and_the_reset_of_the_anchor(make_drive, lever_arm):
    d = spoiled(make_drive(seconds=40, rate=25))
    said = of_fixes(run(InsEkfOptions(lever_arm=lever_arm, gate=GATES["thresholds"]), d))
    assert said[14] == BY_PREDICTION
    assert said[22:27] == [BY_PREDICTION] * 4 + [int(Verdict.ACCEPTED_BY_RESET)]
    far = GateOptions(prediction_limit=1e3, motion_limit=6.0, reset_after=4, probability=1.0)
    said = of_fixes(run(InsEkfOptions(lever_arm=lever_arm, gate=far), d))
    assert said[14] == BY_MOTION
    assert said[22:27] == [BY_MOTION] * 4 + [int(Verdict.ACCEPTED)]


def test_without_an_odometer_in_the_samples_nothing_is_compared(make_drive, lever_arm):
    d = spoiled(make_drive(seconds=40, rate=25))
    silent = d.samples._replace(has_speed=0.0 * d.samples.has_speed)
    options = InsEkfOptions(lever_arm=lever_arm, gate=GATES["motion"])
    assert BY_MOTION not in of_fixes(run(options, d._replace(samples=silent)))
    with pytest.raises(ConfigError, match="motion_reference none"):
        InsEkfOptions(odometer=False, gate=GATES["motion"])
    printed = GateOptions(motion_limit=6.0, motion_reference="none")
    assert InsEkfOptions(odometer=False, gate=printed).gate is printed


@pytest.mark.parametrize("name", ["thresholds", "motion", "all"])
def test_streaming_with_a_watch_beside_it_equals_the_record(make_drive, lever_arm, name):
    d = spoiled(make_drive(seconds=32, rate=25))
    options = InsEkfOptions(
        lever_arm=lever_arm,
        wheel_lever_arm=(0.0, -1.2, 0.0),
        gate=GATES[name],
        zero_velocity=False,
        zero_angular_rate=False,
        nonholonomic=False,
    )
    history = run(options, d)
    watch, index = MotionWatch(options), d.timing.index.tolist()
    track, told = watch.start(d.start.lat), []
    for k in range(len(d.samples.dt)):
        sample = ImuSample(*(x[k] for x in d.samples))
        track = watch.step(track, sample)
        if k in index:
            fix = GnssFix(*(x[index.index(k)] for x in d.fixes))
            track, wild = watch.judge(track, fix, sample, 0.0 * fix.lat)
            told.append(bool(wild > 0.5))
    said = of_fixes(history)
    assert sum(told) > 3
    for wild, verdict in zip(told, said, strict=True):
        assert wild == (verdict == BY_MOTION) or verdict in (
            BY_PREDICTION,
            int(Verdict.ACCEPTED_BY_RESET),
        )


def test_an_update_is_told_that_its_fix_is_astray(make_drive):
    d = make_drive(seconds=8, rate=25)
    options = InsEkfOptions(gate=GATES["motion"])
    ekf, belief = InsEkf(options), initial_ins_belief(options, d.start)
    sample = ImuSample(*(x[24] for x in d.samples))
    fix = GnssFix(*(x[0] for x in d.fixes))
    with torch.no_grad():
        kept = ekf.update(belief, fix, sample, astray=torch.ones_like(fix.lat))
        moved = ekf.update(belief, fix, sample)
    assert float(kept.refused[InsKind.POSITION]) == 1.0
    assert float(moved.refused[InsKind.POSITION]) == 0.0
    assert float(kept.covariance[0, 0]) > float(moved.covariance[0, 0])


@pytest.mark.parametrize("name", ["huber", "all"])
def test_smoothing_keeps_verdicts_and_weights_so_that_it_ends_where_the_filter_does(
    make_drive, lever_arm, name
):
    d = spoiled(make_drive(seconds=40, rate=25))
    options = InsEkfOptions(lever_arm=lever_arm, gate=GATES[name])
    ekf, belief = InsEkf(options), initial_ins_belief(options, d.start)
    history = run(options, d)
    assert bool(refused(history.verdict).any()) or name == "huber"
    with torch.no_grad():
        given = (ekf, belief, d.samples, d.fixes, d.timing, history)
        smoothed = smooth_ins(*given, SmoothingOptions(passes=1))
    end, other = (x.belief.state for x in (smoothed, history))
    gap = enu_between(*(x[-1] for x in end[:3]), *(x[-1] for x in other[:3]))
    assert max(float(x.abs()) for x in gap) < 1e-4


def test_all_blocks_at_once_have_the_gradient_of_the_loop(make_drive, lever_arm):
    d = spoiled(make_drive(seconds=26, rate=25))
    options = InsEkfOptions(lever_arm=lever_arm, gate=GATES["huber"])
    found = {}
    for method in ("exact", "fast"):
        ekf = InsEkf(options)
        ekf.log_noise.requires_grad_(True)
        belief = initial_ins_belief(options, d.start)
        history = ekf(belief, d.samples, d.fixes, d.timing, method=method)
        assert history.method == method
        east, north, _ = enu_between(*history.belief.state[:3], *(x[0] for x in d.truth[:3]))
        (found[method],) = torch.autograd.grad((east - north).square().mean(), ekf.log_noise)
    size = found["exact"].abs().max()
    assert float((found["fast"] - found["exact"]).abs().max() / size) < 1e-2
