"""The full-IMU filter with all blocks at once is the loop over blocks, and says when it is not."""

import pytest
import torch

from navlearn.filters.scan import LinearSteps, filter_in_parallel, filter_in_turn
from navlearn.fusion.ins import fast
from navlearn.fusion.ins.first_guess import first_ins_guess
from navlearn.fusion.ins.layout import state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.ins.timeline import ins_timeline
from navlearn.fusion.measurements import Verdict
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState


def run(options, d, method, fixes=None, sigmas=None, **start):
    belief = initial_ins_belief(options, d.start, sigmas=sigmas, **start)
    with torch.no_grad():
        return InsEkf(options)(belief, d.samples, fixes or d.fixes, d.timing, method=method)


def without(fixes, first, last):
    """Return fixes of which some say nothing."""
    there = torch.ones_like(fixes.lat)
    there[..., first:last] = 0.0
    return fixes._replace(has_position=there, has_velocity=there)


def assert_same(quick, exact, position=1e-4):
    assert (quick.method, exact.method) == ("fast", "exact")
    assert quick.passes > 1
    assert torch.equal(quick.verdict, exact.verdict)
    gap = state_difference(quick.trajectory, exact.trajectory).abs()
    assert float(gap[..., :3].max()) < position
    assert float(gap[..., 6:].max()) < 0.1 * position
    sigma = exact.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    gap = (quick.belief.covariance - exact.belief.covariance).abs()
    assert float((gap / sigma.unsqueeze(-1) / sigma.unsqueeze(-2)).max()) < 2e-3
    gap = (quick.belief.sensor - exact.belief.sensor).abs()
    assert float((gap / sigma[..., 9:]).max()) < 1e-3
    torch.testing.assert_close(quick.nis, exact.nis, rtol=1e-3, atol=1e-3, equal_nan=True)


FORMS = {
    "default": {},
    "scale": {"states": 21},
    "nine": {"states": 9},
    "positions": {"velocity": False, "odometer": False, "nonholonomic": False},
    "delayed": {"max_block": 0.4},
}


@pytest.mark.filterwarnings("ignore:filter")  # nine states cannot explain biased sensors
@pytest.mark.parametrize("name", FORMS)
def test_all_blocks_at_once_equal_the_loop(make_drive, lever_arm, name):
    options = InsEkfOptions(lever_arm=lever_arm, **FORMS[name])
    d = make_drive(seconds=40, rate=25)
    if name == "delayed":
        d = d._replace(timing=d.timing._replace(delay=d.timing.delay + 0.03))
    exact, quick = (run(options, d, method) for method in ("exact", "fast"))
    assert_same(quick, exact)


def test_an_outage_and_a_poor_start(make_drive):
    options = InsEkfOptions()
    d = make_drive(seconds=80, rate=25)
    fixes = without(d.fixes, 45, 75)
    exact, quick = (run(options, d, method, fixes) for method in ("exact", "fast"))
    assert_same(quick, exact)


def test_the_gate_refuses_and_resets_alike(make_drive):
    options = InsEkfOptions()
    d = make_drive(seconds=60, rate=25)
    lat = d.fixes.lat.clone()
    lat[20] += 60.0 / 6.38e6
    lat[35:48] += 80.0 / 6.38e6
    exact, quick = (
        run(options, d, method, d.fixes._replace(lat=lat)) for method in ("exact", "fast")
    )
    assert int((exact.verdict == int(Verdict.REFUSED_BY_GATE)).sum()) > 3
    assert_same(quick, exact, position=1e-3)


def test_a_batch_is_its_drives_one_by_one(make_drive):
    options = InsEkfOptions()
    drives = [make_drive(seconds=20, rate=25, seed=s) for s in (1, 2)]

    def stacked(kind, name):
        parts = zip(*(getattr(d, name) for d in drives), strict=True)
        return kind(*(torch.stack(p) for p in parts))

    together = drives[0]._replace(
        start=stacked(InsState, "start"),
        samples=stacked(ImuSample, "samples"),
        fixes=stacked(GnssFix, "fixes"),
        timing=stacked(FixTiming, "timing"),
    )
    many = run(options, together, "fast")
    for k, d in enumerate(drives):
        alone = run(options, d, "fast")
        row = InsState(*(x[k] for x in many.trajectory))
        gap = state_difference(row, alone.trajectory).abs()
        assert float(gap[..., :6].max()) < 1e-4
        assert torch.equal(many.verdict[k], alone.verdict)


def test_what_has_no_closed_form_is_left_to_the_loop(make_drive):
    d = make_drive(seconds=6, rate=25)
    for options in (
        InsEkfOptions(feedback="open", odometer=False, nonholonomic=False),
        InsEkfOptions(correlation_time=300.0),
        InsEkfOptions(model="dahmane2022", states=9, odometer=False),
    ):
        assert run(options, d, "fast").method == "exact"


def test_passes_that_do_not_converge_are_left_to_the_loop(make_drive, monkeypatch):
    d = make_drive(seconds=12, rate=25)
    monkeypatch.setattr(fast, "TOLERANCE", 0.0)
    assert run(InsEkfOptions(), d, "fast").method == "exact"


def test_the_first_guess_finds_the_attitude_again(make_drive):
    """Gyros that drift ten degrees in a minute; fixes and course tell where the car looks."""
    options = InsEkfOptions()
    d = make_drive(seconds=80, rate=25)
    exact = run(options, d, "exact", sigmas={"gyro_bias": 0.01})
    drift = torch.tensor([0.0, 0.0, 0.004], dtype=torch.float64)
    d = d._replace(samples=d.samples._replace(omega_ib_b=d.samples.omega_ib_b + drift))
    d = d._replace(
        samples=ImuSample(*(x.unsqueeze(0) for x in d.samples)),
        fixes=GnssFix(*(x.unsqueeze(0) for x in d.fixes)),
        timing=FixTiming(*(x.unsqueeze(0) for x in d.timing)),
        start=InsState(*(x.unsqueeze(0) for x in d.start)),
    )
    ekf = InsEkf(options)
    with torch.no_grad():
        line = ins_timeline(ekf.model, d.samples, d.fixes, d.timing)
        passes = fast._Passes(ekf.model, initial_ins_belief(options, d.start), line, ekf.noise)
        guess = first_ins_guess(ekf.model, passes.start, line, passes.sums.pre)
    found = InsState(*(x[0, 1:] for x in guess.state))
    gap = state_difference(found, InsState(*(x[:-1] for x in exact.belief.state)))
    assert float(gap[-1, 6:].abs().max()) < 0.1
    assert float(gap[..., 6:].abs().max()) < 0.2


def test_gradients_are_those_of_the_loop(make_drive):
    options = InsEkfOptions()
    d = make_drive(seconds=15, rate=10)
    told = {}
    for method in ("exact", "fast"):
        ekf = InsEkf(options)
        ekf.log_noise.requires_grad_(True)
        omega = d.samples.omega_ib_b.clone().requires_grad_()
        force = d.samples.f_b.clone().requires_grad_()
        lat = d.start.lat.clone().requires_grad_()
        belief = initial_ins_belief(options, d.start._replace(lat=lat))
        samples = d.samples._replace(omega_ib_b=omega, f_b=force)
        history = ekf(belief, samples, d.fixes, d.timing, method=method)
        assert history.method == method
        path = history.trajectory
        loss = 6.4e6 * (path.lat[-1] - path.lon[-40].detach()) + path.v_l[-30].sum()
        loss = loss + history.belief.sensor.square().sum() + path.q_lb[-1, 3]
        loss.backward()
        told[method] = (omega.grad, force.grad, lat.grad, ekf.log_noise.grad)
    for quick, slow in zip(told["fast"], told["exact"], strict=True):
        size = float(slow.abs().max())
        assert size > 0.0
        assert float((quick - slow).abs().max()) < 5e-3 * size


def test_one_wide_step_after_another_equals_chunks():
    """Filters of large batches go step by step; the textbook recursion is the oracle of both."""
    g = torch.Generator().manual_seed(5)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    n, r, K = 5, 3, 12
    for batch in (2, 20):
        steps = LinearSteps(
            torch.eye(n) + 0.1 * normal(batch, K, n, n),
            normal(batch, K, n),
            0.1 * torch.eye(n, dtype=torch.float64).expand(batch, K, n, n),
            normal(batch, K, r, n),
            1.0 + normal(batch, K, r).square(),
            normal(batch, K, r),
        )
        start = (normal(batch, n), torch.eye(n, dtype=torch.float64).expand(batch, n, n))
        for one, other in zip(
            filter_in_parallel(*start, steps), filter_in_turn(*start, steps), strict=True
        ):
            torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-10)
