"""One filter in several forms: by blocks and by samples, batched and not, streamed."""

import pytest
import torch

from navlearn.errors import ConfigError
from navlearn.filters.ins_belief import map_ins_belief
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.ins.timeline import InsRest
from navlearn.mechanization.strapdown import strapdown_in_turn
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

FORMS = {
    "default": {},
    "scale": {"states": 21},
    "open": {"feedback": "open", "odometer": False, "nonholonomic": False},
    "dahmane2022": {"model": "dahmane2022", "states": 9, "odometer": False},
    "gauss_markov": {"correlation_time": 300.0},
}


def run(options, d, method):
    with torch.no_grad():
        return InsEkf(options)(
            initial_ins_belief(options, d.start), d.samples, d.fixes, d.timing, method=method
        )


@pytest.mark.filterwarnings("ignore:filter")  # nine states cannot explain biased sensors
@pytest.mark.parametrize("name", FORMS)
def test_blocks_equal_samples(make_drive, lever_arm, name):
    options = InsEkfOptions(lever_arm=lever_arm, **FORMS[name])
    d = make_drive(seconds=9, rate=25)
    slow, quick = (run(options, d, method) for method in ("sequential", "exact"))
    assert (slow.method, quick.method) == ("sequential", "exact")
    assert torch.equal(slow.verdict, quick.verdict)
    sigma = slow.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    other = quick.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    torch.testing.assert_close(other, sigma, rtol=2e-3, atol=0.0)
    gap = state_difference(quick.belief.state, slow.belief.state).abs() / sigma[..., :9]
    assert float(gap.max()) < 2e-3
    if name != "open":
        gap = state_difference(quick.trajectory, slow.trajectory).abs()
        assert float(gap[..., :3].max()) < 1e-3
        assert float(gap[..., 6:].max()) < 1e-5


def test_a_batch_is_its_drives_one_by_one(make_drive):
    options = InsEkfOptions()
    drives = [make_drive(seconds=12, rate=25, seed=s) for s in (1, 2)]
    # the second has one fix less, and so a block of another length
    second = drives[1]
    fixes = GnssFix(*(x[1:] for x in second.fixes))
    timing = FixTiming(*(x[1:] for x in second.timing))
    padded = (
        GnssFix(*(torch.cat((x[:1], x)) for x in fixes)),
        FixTiming(*(torch.cat((0 * x[:1] - int(k == 0), x)) for k, x in enumerate(timing))),
    )
    told = [torch.stack(p) for p in zip(drives[0].fixes, padded[0], strict=True)]
    when = [torch.stack(p) for p in zip(drives[0].timing, padded[1], strict=True)]
    samples = ImuSample(*(torch.stack(p) for p in zip(*(d.samples for d in drives), strict=True)))
    start = InsState(*(torch.stack(p) for p in zip(*(d.start for d in drives), strict=True)))
    with torch.no_grad():
        together = InsEkf(options)(
            initial_ins_belief(options, start),
            samples,
            GnssFix(*told),
            FixTiming(*when),
        )
    alone = [
        run(options, drives[0], "exact"),
        run(options, second._replace(fixes=fixes, timing=timing), "exact"),
    ]
    for b, one in enumerate(alone):
        path = InsState(*(x[b] for x in together.trajectory))
        assert float(state_difference(path, one.trajectory).abs().max()) < 1e-7
        torch.testing.assert_close(
            together.belief.covariance[b, -1], one.belief.covariance[-1], rtol=1e-9, atol=1e-18
        )


def test_streaming_is_the_sequential_form(make_drive, lever_arm):
    d = make_drive(seconds=7, rate=25)
    options = InsEkfOptions(lever_arm=lever_arm, zero_velocity=False, zero_angular_rate=False)
    history = run(options, d, "sequential")
    ekf = InsEkf(options)
    belief = initial_ins_belief(options, d.start)
    one = torch.ones((), dtype=torch.float64)
    with torch.no_grad():
        for k in range(len(d.samples.dt)):
            sample = ImuSample(*(x[k] for x in d.samples))
            belief = ekf.step(belief, sample)
            for m in (d.timing.index == k).nonzero()[:, 0].tolist():
                fix = GnssFix(*(x[m] for x in d.fixes))
                belief = ekf.update(belief, fix, sample, aided=one)
    last = map_ins_belief(history.belief, lambda x: x[-1])
    # coning between samples is told to the filter, not to the stream
    assert float(state_difference(belief.state, last.state).abs().max()) < 1e-4
    torch.testing.assert_close(belief.covariance, last.covariance, rtol=1e-3, atol=1e-12)


def test_streamed_standstill_tells_the_gyro_bias(make_drive):
    d = make_drive(seconds=6, rate=25)
    options = InsEkfOptions()
    ekf, belief = InsEkf(options), initial_ins_belief(options, d.start)
    sample = ImuSample(*(x[0] for x in d.samples))
    one = torch.ones((), dtype=torch.float64)
    none = GnssFix(*(0.0 * x[0] for x in d.fixes))
    rest = InsRest(one, sample.omega_ib_b, one)
    with torch.no_grad():
        after = ekf.update(belief, none, sample, rest=rest)
    torch.testing.assert_close(
        after.sensor[:3], torch.tensor([0.001, -0.002, 0.0015]).double(), atol=1e-4, rtol=0.0
    )


@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_no_fixes_and_invalid_fixes_are_the_same(make_drive, method):
    d = make_drive(seconds=6, rate=25)
    options = InsEkfOptions()
    none = d._replace(
        fixes=GnssFix(*(x[:0] for x in d.fixes)), timing=FixTiming(*(x[:0] for x in d.timing))
    )
    zero = 0.0 * d.fixes.lat
    invalid = d._replace(fixes=d.fixes._replace(has_position=zero, has_velocity=zero))
    found = [run(options, drive, method) for drive in (none, invalid)]
    gap = state_difference(found[0].trajectory, found[1].trajectory)
    assert float(gap.abs().max()) < 1e-6
    assert bool((found[1].verdict[..., :2] == 0).all())
    assert bool(torch.isnan(found[1].nis[..., :2]).all())


def test_an_unknown_form_is_refused(make_drive):
    with pytest.raises(ConfigError, match="method 'quick'"):
        run(InsEkfOptions(), make_drive(seconds=6, rate=25), "quick")


@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_a_filter_without_aids_is_the_strapdown(make_clean, method):
    d = make_clean(12.0, 25)
    nothing = dict.fromkeys(
        ("position", "velocity", "odometer", "nonholonomic", "zero_velocity", "zero_angular_rate"),
        False,
    )
    history = run(InsEkfOptions(**nothing), d, method)
    path = strapdown_in_turn(d.start, d.samples)
    gap = state_difference(history.trajectory, path).abs()
    assert float(gap[:, :3].max()) < 1e-4
    assert float(gap[:, 6:].max()) < 1e-7
    # the car did move, and the strapdown with it
    assert float(state_difference(path, d.truth)[-1, :3].norm()) < 0.2
    assert float(d.truth.v_l[-1].norm()) > 3.0
