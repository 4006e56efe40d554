"""All blocks at once give what the loop over blocks gives."""

import math

import pytest
import torch

from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between
from navlearn.fusion.continued import continued
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.unscented import fast
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix


def run(options, d, method, *, sigma=None, off=0.0, filter_=LooselyCoupledUkf):
    """Run a filter whose azimuth starts ``off`` rad wrong, told to be ``sigma`` rad uncertain."""
    with torch.no_grad():
        sigmas = {} if sigma is None else {"azimuth": sigma}
        belief = initial_belief(options, d.start, sigmas=sigmas)
        state = belief.state._replace(azimuth=belief.state.azimuth + off)
        belief = belief._replace(state=state)
        return filter_(options)(belief, d.samples, d.fixes, d.timing, method=method)


def apart(a, b):
    """Largest distance between two trajectories or states, m."""
    return max(float(x.abs().max()) for x in enu_between(*a[:3], *b[:3]))


def relative(P, other):
    variance = other.diagonal(dim1=-2, dim2=-1)
    sigma = torch.where(variance > 0.0, variance, torch.inf).sqrt()
    return float(((P - other).abs() / (sigma[..., None] * sigma[..., None, :])).max())


def assert_alike(fast_run, exact, metres=5e-5, spread=1e-3):
    assert fast_run.method == "fast"
    assert torch.equal(fast_run.verdict, exact.verdict)
    assert apart(fast_run.trajectory, exact.trajectory) < metres
    assert apart(fast_run.prior.state, exact.prior.state) < metres
    assert relative(fast_run.belief.covariance, exact.belief.covariance) < spread
    assert relative(fast_run.prior.covariance, exact.prior.covariance) < spread
    torch.testing.assert_close(
        fast_run.nis, exact.nis, atol=10.0 * spread, rtol=10.0 * spread, equal_nan=True
    )
    assert fast_run.belief.covariance.dtype == torch.float64


VARIANTS = {
    "bias_scale": EkfOptions(),
    "augmented": EkfOptions(
        gyro_terms=("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y"),
        speed_terms=("scale", "delay", "offset"),
    ),
    "gauss_markov": EkfOptions(correlation_time=100.0),
    "flat": EkfOptions(mechanization=RissOptions(dimensions=2)),
    "bias_free": EkfOptions(model="bias_free", velocity=False),
    "course": EkfOptions(velocity=False, course=True, zero_speed=False),
    "lever": EkfOptions(lever_arm=(0.4, -1.0, 1.5)),
    "shen2010_full": EkfOptions(model="shen2010_full"),
    "narrow_points": EkfOptions(unscented=UnscentedOptions(alpha=1e-3)),
    "heavy_centre": EkfOptions(unscented=UnscentedOptions(alpha=0.7, beta=0.0, kappa=1.0)),
}


WIDE = EkfOptions(unscented=UnscentedOptions(alpha=1.0))
"""Points at √n deviations."""


@pytest.mark.parametrize("name", VARIANTS)
def test_all_blocks_at_once_equal_the_loop(make_drive, name):
    options = VARIANTS[name]
    d = make_drive(seconds=60, batch=2)
    d = d._replace(timing=d.timing._replace(delay=d.timing.delay + 0.02))
    exact, at_once = run(options, d, "exact"), run(options, d, "fast")
    assert at_once.passes <= 10
    assert_alike(at_once, exact)


def test_it_is_not_the_extended_filter(make_drive):
    d, options = make_drive(seconds=60), EkfOptions()
    exact, at_once = run(options, d, "exact"), run(options, d, "fast")
    extended = run(options, d, "exact", filter_=LooselyCoupledEkf)
    assert apart(extended.trajectory, exact.trajectory) > 100.0 * apart(
        at_once.trajectory, exact.trajectory
    )


def test_outages_and_a_refused_fix(make_drive):
    d = make_drive(seconds=200)
    there = torch.ones_like(d.fixes.lat)
    there[:, 80:120] = 0.0
    lat = d.fixes.lat.clone()
    lat[0, 50] += 50.0 / 6.37e6
    d = d._replace(fixes=d.fixes._replace(lat=lat, has_position=there, has_velocity=there))
    exact, at_once = run(EkfOptions(), d, "exact"), run(EkfOptions(), d, "fast")
    k = int((exact.fix[0] == 50).nonzero()[0])
    assert int(exact.verdict[0, k, Kind.POSITION]) == Verdict.REFUSED_BY_GATE
    assert_alike(at_once, exact)


def test_resets_are_found(make_drive):
    d = make_drive(seconds=80)
    lat = d.fixes.lat.clone()
    lat[0, 40:] += 200.0 / 6.37e6
    d = d._replace(fixes=d.fixes._replace(lat=lat))
    options = EkfOptions(velocity=False, gate=GateOptions(reset_after=5))
    exact, at_once = run(options, d, "exact"), run(options, d, "fast")
    assert int(exact.resets[0, Kind.POSITION]) == 1
    assert_alike(at_once, exact)


@pytest.mark.parametrize("gate", [GateOptions(robust="huber"), GateOptions(prediction_limit=8.0)])
def test_other_gates_are_found(make_drive, gate):
    d = make_drive(seconds=80, position_sigma=2.0)
    lat = d.fixes.lat.clone()
    lat[0, 40] += 12.0 / 6.37e6
    d = d._replace(fixes=d.fixes._replace(lat=lat))
    options = EkfOptions(gate=gate)
    exact, at_once = run(options, d, "exact"), run(options, d, "fast")
    assert bool((exact.verdict > Verdict.ACCEPTED).any())
    assert_alike(at_once, exact, spread=5e-3)


@pytest.mark.parametrize(
    ("off", "sigma"), [(60.0, 60.0), (-60.0, 30.0), (120.0, 90.0), (180.0, 180.0)]
)
def test_azimuth_may_be_lost_at_the_start(make_drive, off, sigma):
    d = make_drive(seconds=60, seed=2)
    where = {"sigma": math.radians(sigma), "off": math.radians(off)}
    exact = run(WIDE, d, "exact", **where)
    at_once = run(WIDE, d, "fast", **where)
    assert_alike(at_once, exact)
    gone = exact.belief.state.azimuth[:, -1] - d.truth.azimuth[:, -1]
    assert float(torch.sin(0.5 * gone).abs()) < 0.05


@pytest.mark.filterwarnings("ignore:filter")
def test_a_filter_gone_astray_is_followed(make_drive):
    """Resets throw the car about by hundreds of metres."""
    d = make_drive(seconds=60, seed=3)
    exact = run(WIDE, d, "exact", sigma=1.05, off=1.05)
    at_once = run(WIDE, d, "fast", sigma=1.05, off=1.05)
    assert int((exact.verdict == Verdict.REFUSED_BY_GATE).sum()) > 30
    assert_alike(at_once, exact, metres=2e-4)


def test_a_loop_of_its_own_where_azimuth_is_never_known(make_drive):
    d = make_drive(seconds=20)
    none = GnssFix(*(x[:, :0] for x in d.fixes))
    d = d._replace(fixes=none, timing=FixTiming(*(x[:, :0] for x in d.timing)))
    exact = run(EkfOptions(), d, "exact", sigma=2.0)
    at_once = run(EkfOptions(), d, "fast", sigma=2.0)
    assert at_once.method == "exact"
    assert torch.equal(at_once.trajectory.lat, exact.trajectory.lat)


def test_the_loop_answers_where_passes_fail(make_drive, monkeypatch):
    d = make_drive(seconds=20)
    monkeypatch.setattr(fast, "solved", lambda *_: None)
    exact = run(EkfOptions(), d, "exact", sigma=1.0)
    at_once = run(EkfOptions(), d, "fast", sigma=1.0)
    assert at_once.method == "exact"
    assert torch.equal(at_once.belief.covariance, exact.belief.covariance)


def test_without_fixes(make_drive):
    d = make_drive(seconds=30)
    none = GnssFix(*(x[:, :0] for x in d.fixes))
    d = d._replace(fixes=none, timing=FixTiming(*(x[:, :0] for x in d.timing)))
    assert_alike(run(EkfOptions(), d, "fast"), run(EkfOptions(), d, "exact"))


def test_one_block(make_drive):
    d = make_drive(seconds=1)
    assert_alike(run(EkfOptions(), d, "fast"), run(EkfOptions(), d, "exact"))


def test_a_padded_batch_equals_one_by_one(make_drive):
    d = make_drive(seconds=30, batch=3)
    ragged = d.timing.index.clone()
    ragged[1, 10:] = -1
    d = d._replace(timing=d.timing._replace(index=ragged))
    whole = run(EkfOptions(), d, "fast")
    assert_alike(whole, run(EkfOptions(), d, "exact"))
    for b in range(3):
        one = run(EkfOptions(), map_tree(d, lambda x, b=b: x[b : b + 1]), "fast")
        alone = [x[0] for x in one.trajectory]
        assert apart([x[b] for x in whole.trajectory], alone) < 5e-5


def test_two_fixes_may_share_a_sample(make_drive):
    d = make_drive(seconds=20)
    twice = [torch.repeat_interleave(x, 2, dim=1) for x in d.fixes]
    fixes = GnssFix(*twice)
    first = torch.arange(fixes.lat.shape[1]) % 2 == 0
    fixes = fixes._replace(
        has_position=fixes.has_position * first, has_velocity=fixes.has_velocity * ~first
    )
    timing = FixTiming(*(torch.repeat_interleave(x, 2, dim=1) for x in d.timing))
    d = d._replace(fixes=fixes, timing=timing)
    assert_alike(run(EkfOptions(), d, "fast"), run(EkfOptions(), d, "exact"))


def test_a_run_goes_on_from_its_own_beliefs(make_drive):
    """Mean, covariance and refusals in a row are all that a run needs of what was before."""
    d = map_tree(make_drive(seconds=40), lambda x: x[0])
    lat = d.fixes.lat.clone()
    lat[18:] += 100.0 / 6.37e6
    d = d._replace(fixes=d.fixes._replace(lat=lat))
    options, gone = EkfOptions(gate=GateOptions(reset_after=4)), 20
    whole = run(options, d, "fast")
    stop = int(d.timing.index[gone]) + 1
    start, truth, samples, fixes, timing = d
    samples, truth = (map_tree(part, lambda x: x[:stop]) for part in (samples, truth))
    fixes, timing = (map_tree(part, lambda x: x[: gone + 1]) for part in (fixes, timing))
    earlier = run(options, type(d)(start, truth, samples, fixes, timing), "fast")
    block = int((earlier.fix == gone).nonzero())
    assert 0.0 < float(earlier.belief.refused[block, Kind.POSITION]) < 4.0
    ukf = LooselyCoupledUkf(options)
    found = continued(ukf, earlier, block, d.samples, d.fixes, d.timing)
    assert int(found.resets[Kind.POSITION]) == 1
    assert_alike(found, whole)
