"""Log-likelihood of a drive's innovations: against NumPy, other forms, differences, and gaming."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from navlearn.errors import ConfigError
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.filter_model import filter_model, predict_blocks
from navlearn.fusion.first_guess import first_guess
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.gated_pass import everything_believed
from navlearn.fusion.gating import Judged
from navlearn.fusion.innovation_likelihood import (
    LikelihoodOptions,
    foretold,
    history_log_likelihood,
)
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.noise import EkfNoise, log_noise, noise_from_log
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.timeline import timeline
from navlearn.fusion.updates import measured

NORMAL = LikelihoodOptions(freedom=math.inf)
OPEN = GateOptions(probability=1.0)


class Case:
    """One filter over one drive, run by the loop over blocks."""

    def __init__(self, options, d, method="exact"):
        self.options, self.model = options, filter_model(options)
        self.start = initial_belief(options, d.start)
        self.line = timeline(self.model, d.samples, d.fixes, d.timing)
        with torch.no_grad():
            self.history = LooselyCoupledEkf(options)(
                self.start, d.samples, d.fixes, d.timing, method=method
            )

    def noise(self, noise=None):
        return noise_from_log(log_noise(noise or self.options.noise))

    def of_history(self, likelihood=None):
        return history_log_likelihood(self.model, self.line, self.history, self.noise(), likelihood)

    def said(self):
        h = self.history
        return Judged(h.nis, h.verdict, h.belief.refused)

    def foretold(self, noise, likelihood=None, said=None):
        begin = first_guess(self.model, self.start, self.line)
        return foretold(
            self.model, self.start, self.line, noise, begin, said or self.said(), likelihood
        )


def test_likelihood_is_that_of_a_kalman_filter_in_numpy(make_drive):
    case = Case(EkfOptions(gate=OPEN), make_drive(seconds=40, rate=5))
    begin = starts_of_blocks(case.start, case.history.belief)
    noise, line = case.noise(), case.line
    ahead = predict_blocks(case.model, begin, line.samples, line.acceleration, noise)
    found = measured(case.model.measurement, case.history.prior, line.occasion, noise)
    P, total = case.start.covariance[0].numpy(), 0.0
    for k in range(line.blocks.end.shape[1]):
        phi, q = (x[0, k].numpy() for x in ahead.linearised)
        P = phi @ P @ phi.T + q
        nu = case.history.innovation[0, k].numpy()
        there = np.isfinite(nu)
        H = found.observation[0, k].numpy()[there]
        S = H @ P @ H.T + np.diag(found.variance[0, k].numpy()[there])
        total += stats.multivariate_normal(np.zeros(len(S)), S).logpdf(nu[there])
        P = P - P @ H.T @ np.linalg.solve(S, H @ P)
    assert float(case.of_history(NORMAL).sum()) == pytest.approx(total, rel=1e-9)
    assert float(case.foretold(noise, NORMAL).log_likelihood.sum()) == pytest.approx(
        total, abs=1e-3
    )
    kinds = case.of_history(NORMAL).sum((0, 1))
    assert (kinds != 0.0).tolist() == [True, True, False, True, False]


def test_all_blocks_at_once_tell_what_the_loop_tells_behind_a_gate(make_drive):
    d = _spiked(make_drive(seconds=60, rate=5, batch=2))
    case = Case(EkfOptions(), d)
    assert int((case.history.verdict == int(Verdict.REFUSED_BY_GATE)).sum()) >= 4
    loop, once = case.of_history(), case.foretold(case.noise()).log_likelihood
    assert torch.allclose(once, loop, atol=2e-3)


@pytest.mark.parametrize("model", ["bias_scale", "shen2010_full"])
def test_gradient_is_that_of_differences_of_the_loop(make_drive, model):
    d = make_drive(seconds=30, rate=4)
    options = EkfOptions(model=model, gate=OPEN)
    case = Case(options, d)
    logs = log_noise(options.noise).requires_grad_(True)
    total = case.foretold(noise_from_log(logs)).log_likelihood.sum()
    (slope,) = torch.autograd.grad(total, logs)
    for seed in (0, 1):
        way = torch.randn(len(logs), generator=torch.Generator().manual_seed(seed)).double()
        ends = []
        for step in (1e-3, -1e-3):
            values = torch.exp(logs.detach() + step * way).tolist()
            noise = NoiseOptions(**dict(zip(EkfNoise._fields, values, strict=True)))
            ends.append(float(Case(replace(options, noise=noise), d).of_history().sum()))
        difference = (ends[0] - ends[1]) / 2e-3
        assert float(slope @ way) == pytest.approx(difference, rel=1e-3, abs=1e-2)


def _spiked(d, size=2e-5):
    """The same drive with every eleventh position wrong by about 100 m."""
    wrong = torch.zeros_like(d.fixes.lat)
    wrong[..., 8::11] = size
    return d._replace(fixes=d.fixes._replace(lat=d.fixes.lat + wrong))


@pytest.mark.filterwarnings("ignore:filter.:UserWarning")
@pytest.mark.parametrize(("probability", "spiked"), [(0.999, True), (0.9, False), (0.5, True)])
def test_no_noise_is_rewarded_for_what_it_refuses(model_drives, probability, spiked):
    options, _, d, _ = model_drives(1, 100, 7)
    d = _spiked(d) if spiked else d
    options = replace(options, gate=GateOptions(probability=probability))
    totals, refused = {}, {}
    for factor in (0.1, 0.4, 1.0, 3.0):
        # R that the drive was drawn with, and less and more of it
        noise = replace(options.noise, position_inflation=factor, velocity_inflation=factor)
        case = Case(replace(options, noise=noise), d, "fast")
        totals[factor] = float(case.of_history().sum())
        refused[factor] = int((case.history.verdict == int(Verdict.REFUSED_BY_GATE)).sum())
    assert refused[0.1] > refused[1.0] + 20
    assert max(totals, key=lambda factor: totals[factor]) == 1.0
    assert totals[0.1] < totals[0.4] < totals[1.0] > totals[3.0]


def test_every_measurement_counts_believed_or_not(make_drive):
    d = _spiked(make_drive(seconds=60, rate=5))
    case = Case(EkfOptions(), d)
    by_kind, verdict = case.of_history(), case.history.verdict
    assert ((by_kind != 0.0) == (verdict != int(Verdict.ABSENT))).all()
    refused = verdict[..., Kind.POSITION] == int(Verdict.REFUSED_BY_GATE)
    assert bool(refused.any())
    assert float(by_kind[..., Kind.POSITION][refused].max()) < -15.0


def test_a_wild_fix_costs_a_bounded_price(make_drive):
    d = make_drive(seconds=60, rate=5)
    prices = []
    for size in (2e-5, 2e-3):
        fixes = d.fixes._replace(lat=d.fixes.lat.clone())
        fixes.lat[..., 30] += size
        wild = Case(EkfOptions(), d._replace(fixes=fixes)).of_history()
        prices.append(float(wild.sum()))
    clean = float(Case(EkfOptions(), d).of_history().sum())
    assert clean - 80.0 < prices[1] < prices[0] < clean
    # a refused position does not spoil what is said of the velocity beside it
    assert prices[0] - prices[1] == pytest.approx(4.0 * math.log(1e4), rel=0.05)


def test_padding_and_missing_fixes_count_for_nothing(make_drive):
    d = make_drive(seconds=40, rate=5)
    gone = torch.ones_like(d.fixes.has_position)
    gone[..., 10:25] = 0.0
    d = d._replace(fixes=d.fixes._replace(has_position=gone, has_velocity=gone))
    case = Case(EkfOptions(zero_yaw_rate=False), d)
    by_block = case.of_history().sum(-1)[0]
    assert bool((by_block[10:25] == 0.0).all())
    assert int((by_block != 0.0).sum()) == int(gone.sum())


def test_open_feedback_is_refused(make_drive):
    d = make_drive(seconds=10, rate=5)
    case = Case(EkfOptions(feedback="open"), d)
    said = everything_believed(case.model, torch.ones_like(case.history.nis))
    with pytest.raises(ConfigError, match="feedback"):
        case.foretold(case.noise(), said=said)


@pytest.mark.parametrize("freedom", [0.0, -1.0, math.nan])
def test_density_has_freedom(freedom):
    with pytest.raises(ConfigError, match="freedom"):
        LikelihoodOptions(freedom=freedom)
