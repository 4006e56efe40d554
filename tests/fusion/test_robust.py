"""Robust weights inside the RISS filter: all its forms, its smoother, its gradients."""

import pytest
import torch

from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.robust import weights
from navlearn.fusion.smoothing import SmoothingOptions, smooth

pytestmark = pytest.mark.filterwarnings("ignore:filter. :UserWarning")
GATES = {
    "huber": GateOptions(robust="huber", probability=1.0),
    "student": GateOptions(robust="student", probability=1.0),
    "huber inside the gate": GateOptions(robust="huber", probability=1.0 - 1e-12, reset_after=4),
    "everything": GateOptions(
        robust="student",
        freedom=3.0,
        probability=1.0 - 1e-9,
        prediction_limit=40.0,
        motion_limit=25.0,
        reset_after=3,
    ),
}


def heavy(make_drive, seconds=50, batch=2, share=0.15, size=12.0, seed=3, **more):
    """Drives whose fixes are now and then far off, as one receiver's are."""
    d = make_drive(seconds=seconds, rate=10, batch=batch, seed=seed, **more)
    g = torch.Generator().manual_seed(seed + 1)
    shape = d.fixes.lat.shape
    hit = torch.rand(shape, generator=g, dtype=torch.float64) < share
    off = [size * hit * torch.randn(shape, generator=g, dtype=torch.float64) for _ in range(3)]
    lat, lon, height = shift_geodetic(*d.fixes[:3], *off)
    return d._replace(fixes=d.fixes._replace(lat=lat, lon=lon, height=height))


def run(options, d, method="exact", ekf=None):
    ekf = ekf or LooselyCoupledEkf(options)
    return ekf(initial_belief(options, d.start), d.samples, d.fixes, d.timing, method=method)


def apart(a, b):
    return max(float(x.detach().abs().max()) for x in enu_between(*a[:3], *b[:3]))


def rms(history, d):
    east, north, _ = enu_between(*history.trajectory[:3], *d.truth[:3])
    return float((east.square() + north.square()).mean().sqrt())


@pytest.mark.parametrize("name", GATES)
def test_all_forms_find_the_same_weights(make_drive, name):
    d = heavy(make_drive)
    options = EkfOptions(gate=GATES[name])
    with torch.no_grad():
        exact, fast, turn = (run(options, d, m) for m in ("exact", "fast", "sequential"))
    assert fast.method == "fast"
    model = LooselyCoupledEkf(options).model
    weight = weights(model.gate, model.rows, exact.nis, exact.verdict)
    assert 2 < int((weight[..., Kind.POSITION] < 1.0).sum()) < 60
    for other in (fast, turn):
        assert torch.equal(other.verdict, exact.verdict)
        assert apart(other.trajectory, exact.trajectory) < 2e-3
        torch.testing.assert_close(other.nis, exact.nis, rtol=1e-2, atol=1e-2, equal_nan=True)
    for b in range(2):
        alone = type(d)(*(type(v)(*(x[b : b + 1] for x in v)) for v in d))
        with torch.no_grad():
            single = run(options, alone)
        assert torch.equal(single.verdict[0], exact.verdict[b])


@pytest.mark.parametrize("name", ["huber", "student"])
def test_outliers_do_less_harm_and_good_fixes_count_nearly_as_before(make_drive, name):
    plain, robust = (EkfOptions(gate=g) for g in (GateOptions(probability=1.0), GATES[name]))
    with torch.no_grad():
        wild = heavy(make_drive, seconds=120, share=0.2, size=25.0)
        assert rms(run(robust, wild, "fast"), wild) < 0.6 * rms(run(plain, wild, "fast"), wild)
        good = heavy(make_drive, seconds=120, share=0.0)
        assert rms(run(robust, good, "fast"), good) < 1.15 * rms(run(plain, good, "fast"), good)


def test_without_weights_the_history_tells_none(make_drive):
    d = heavy(make_drive, seconds=20)
    with torch.no_grad():
        history = run(EkfOptions(), d)
    model = LooselyCoupledEkf(EkfOptions()).model
    assert weights(model.gate, model.rows, history.nis, history.verdict) is None
    assert not bool((history.verdict == int(Verdict.ACCEPTED_WITH_LESS_WEIGHT)).any())


@pytest.mark.parametrize("name", ["huber", "everything"])
def test_smoothing_keeps_the_weights_so_that_it_ends_where_the_filter_does(make_drive, name):
    d = heavy(make_drive)
    options = EkfOptions(gate=GATES[name])
    ekf, belief = LooselyCoupledEkf(options), initial_belief(options, d.start)
    with torch.no_grad():
        history = run(options, d, ekf=ekf)
        given = (ekf, belief, d.samples, d.fixes, d.timing, history)
        smoothed = smooth(*given, SmoothingOptions(passes=1))
    last = [x[:, -1] for x in smoothed.belief.state]
    assert apart(last, [x[:, -1] for x in history.belief.state]) < 1e-6
    torch.testing.assert_close(
        smoothed.belief.covariance[:, -1], history.belief.covariance[:, -1], rtol=1e-6, atol=1e-12
    )


def test_student_with_a_far_gate_is_freed_by_the_reset(make_drive):
    d = make_drive(seconds=70, rate=10)
    none = torch.zeros_like(d.fixes.lat)
    east = none.clone()
    east[:, 40:] = 300.0
    lat, lon, height = shift_geodetic(*d.fixes[:3], east, none, none)
    d = d._replace(fixes=d.fixes._replace(lat=lat, lon=lon, height=height, has_velocity=none))
    options = EkfOptions(gate=GateOptions(robust="student", probability=1.0 - 1e-9, reset_after=5))
    with torch.no_grad():
        history = run(options, d)
    said = history.verdict[0, history.fix[0] >= 0, Kind.POSITION].tolist()
    assert said[40:46] == [int(Verdict.REFUSED_BY_GATE)] * 5 + [int(Verdict.ACCEPTED_BY_RESET)]
    assert (
        apart([x[:, -1] for x in history.belief.state], [lat[:, -1], lon[:, -1], height[:, -1]]) < 8
    )


@pytest.mark.parametrize("name", ["huber", "student"])
def test_all_blocks_at_once_have_the_gradient_of_the_loop(make_drive, name):
    d = heavy(make_drive, seconds=30, batch=1, share=0.3)
    options = EkfOptions(gate=GATES[name])
    found = {}
    for method in ("exact", "fast"):
        ekf = LooselyCoupledEkf(options)
        ekf.log_noise.requires_grad_(True)
        history = run(options, d, method, ekf)
        assert history.method == method
        east, north, _ = enu_between(*history.belief.state[:3], *(x[:, :1] for x in d.truth[:3]))
        loss = (east - north).square().mean()
        found[method] = torch.autograd.grad(loss, ekf.log_noise)[0]
    size = found["exact"].abs().max()
    assert float((found["fast"] - found["exact"]).abs().max() / size) < 5e-3


def test_the_gradient_of_the_loop_is_that_of_differences(make_drive):
    d = heavy(make_drive, seconds=12, batch=1, share=0.4)
    options = EkfOptions(gate=GATES["huber"])
    ekf = LooselyCoupledEkf(options)

    def loss():
        history = run(options, d, ekf=ekf)
        east, north, _ = enu_between(*history.belief.state[:3], *(x[:, :1] for x in d.truth[:3]))
        return (east - north).square().mean()

    ekf.log_noise.requires_grad_(True)
    slope = torch.autograd.grad(loss(), ekf.log_noise)[0]
    at = int(slope.abs().argmax())
    with torch.no_grad():
        values = []
        for step in (-1e-3, 1e-3):
            ekf.log_noise[at] += step
            values.append(float(loss()))
            ekf.log_noise[at] -= step
    assert float(slope[at]) == pytest.approx((values[1] - values[0]) / 2e-3, rel=1e-4)
