"""The unscented filter of a full IMU: against the textbook, and itself."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.errors import ConfigError, ShapeError
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import UnscentedOptions, sigma_weights
from navlearn.fusion.filters_of import ins_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.layout import belief_difference, moved_belief, state_difference
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.ins.streaming import InsPredictor
from navlearn.fusion.ins.timeline import coning_compensated, ins_rest_at_end
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.ins_vehicle import InsVehicle
from navlearn.fusion.tight.vehicle import blocks_in_turn
from navlearn.fusion.unscented.ins import InsUkf
from navlearn.states import GnssFix, ImuSample, InsState

NO_GATE = GateOptions(probability=1.0)


CHOICES: dict[str, dict[str, Any]] = {
    "9": {"states": 9, "odometer_scale": False},
    "15": {},
    "21": {"states": 21, "wheel_lever_arm": (0.1, -1.2, -0.4)},
    "gauss_markov": {"correlation_time": 200.0},
    "dahmane2022": {"model": "dahmane2022", "nonholonomic": False},
}


def unscented(alpha: float | None = None, **more: Any) -> InsEkfOptions:
    return InsEkfOptions(
        unscented=UnscentedOptions(alpha=alpha), lever_arm=(0.4, -0.8, 1.3), **more
    )


def filtered(options: InsEkfOptions, d: Any, method: str = "exact", wrong: Any = None) -> Any:
    belief = initial_ins_belief(options, d.start)
    if wrong is not None:
        belief = moved_belief(belief, wrong)
    with torch.no_grad():
        return ins_filter(options)(belief, d.samples, d.fixes, d.timing, method=method)


def apart(one: InsHistory, other: InsHistory) -> tuple[float, float]:
    """Largest difference of estimates and of covariances, in deviations."""
    sigma = other.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    mean = torch.stack([belief_difference(one.belief, other.belief)]) / sigma
    gap = (one.belief.covariance - other.belief.covariance) / (
        sigma.unsqueeze(-1) * sigma.unsqueeze(-2)
    )
    return float(mean.abs().max()), float(gap.abs().max())


def textbook(options: InsEkfOptions, d: Any) -> tuple[InsBelief, Tensor]:
    """Scaled unscented filter with its weights as printed (the sum, not the product), P by sums."""
    chosen = options.unscented
    assert chosen is not None
    vehicle = InsVehicle(options)
    n = len(vehicle.names)
    square = 3.0 / (n + chosen.kappa) if chosen.alpha is None else chosen.alpha**2
    scale = square * (n + chosen.kappa)
    mean = torch.full((2 * n + 1,), 0.5 / scale).double()
    cov = mean.clone()
    mean[0] = (scale - n) / scale
    cov[0] = mean[0] + 1.0 - square + chosen.beta

    def many(tree: Any) -> Any:
        return map_tree(tree, lambda x: x.unsqueeze(1).expand(x.shape[0], 2 * n + 1, *x.shape[1:]))

    def drawn(belief: InsBelief) -> tuple[Tensor, InsBelief]:
        way = math.sqrt(scale) * torch.linalg.cholesky(belief.covariance).mT
        deviation = torch.cat((torch.zeros_like(way[:, :1]), way, -way), 1)
        return deviation, moved_belief(many(belief), deviation)

    def product(one: Tensor, other: Tensor) -> Tensor:
        return (cov[:, None, None] * one.unsqueeze(-1) * other.unsqueeze(-2)).sum(1)

    belief = map_ins_belief(initial_ins_belief(options, d.start), lambda x: x.unsqueeze(0))
    samples, fixes, timing = (
        map_tree(part, lambda x: x.unsqueeze(0)) for part in (d.samples, d.fixes, d.timing)
    )
    after, innovations = [], []
    for block in blocks_in_turn(vehicle, vehicle.laid_out(samples, fixes, timing)):
        noise = vehicle.predicted(belief, block).noise
        ends = vehicle.carried(drawn(belief)[1], many(block))
        centre = map_ins_belief(ends, lambda x: x[:, 0])
        gone = belief_difference(ends, many(centre))
        shift = (mean[:, None] * gone).sum(1)
        spread = product(gone - shift[:, None], gone - shift[:, None]) + noise
        belief = moved_belief(centre, shift)._replace(covariance=spread)
        deviation, points = drawn(belief)
        found = vehicle.measured(points, many(block))
        innovation = (mean[:, None] * found.innovation).sum(1)
        seen = innovation[:, None] - found.innovation
        S = product(seen, seen) + torch.diag_embed(found.variance[:, 0])
        gain = torch.linalg.solve(S, product(deviation, seen).mT).mT
        belief = moved_belief(belief, (gain @ innovation.unsqueeze(-1)).squeeze(-1))
        belief = belief._replace(covariance=spread - gain @ S @ gain.mT)
        after.append(belief)
        innovations.append(innovation[0])
    whole = map_tree(after[0], lambda x: x)
    stacked = [torch.cat(x) for x in zip(*map(leaves, after), strict=True)]
    state, rest = InsState(*stacked[:5]), stacked[5:]
    return whole._replace(state=state, sensor=rest[0], covariance=rest[1]), torch.stack(innovations)


def leaves(belief: InsBelief) -> list[Tensor]:
    return [*belief.state, *belief[1:]]


@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("alpha", [None, 1.0])
def test_equals_the_textbook(make_drive: Any, name: str, alpha: float | None) -> None:
    d = make_drive(seconds=16, rate=20)
    options = unscented(alpha, gate=NO_GATE, **CHOICES[name])
    with torch.no_grad():
        belief, innovation = textbook(options, d)
    found = filtered(options, d)
    sigma = belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    gap = belief_difference(found.belief, belief) / sigma
    # what is left out: how the axes of a start elsewhere are turned
    assert float(gap.abs().max()) < 5e-5
    spread = (found.belief.covariance - belief.covariance) / (sigma[..., None] * sigma[:, None])
    assert float(spread.abs().max()) < 5e-5
    there = ~torch.isnan(found.innovation)
    torch.testing.assert_close(found.innovation[there], innovation[there], rtol=1e-5, atol=1e-4)
    assert there.any(0).sum() > 6


@pytest.mark.parametrize("name", CHOICES)
def test_forms_agree(make_drive: Any, name: str) -> None:
    d = make_drive(seconds=12, rate=20)
    options = unscented(0.5, **CHOICES[name])
    exact, slow = filtered(options, d), filtered(options, d, "sequential")
    fast = filtered(options, d, "fast")
    assert (exact.method, slow.method) == ("exact", "sequential")
    # points drawn once a block or at every sample: near, not the same
    assert max(apart(slow, exact)) < (0.3 if name == "9" else 0.15)
    closed = name in ("9", "15", "21")
    assert fast.method == ("fast" if closed else "exact")
    assert max(apart(fast, exact)) < 1e-3
    assert torch.equal(fast.verdict, exact.verdict)


def test_batches_and_streaming(make_drive: Any) -> None:
    d = make_drive(seconds=10, rate=10)
    options = unscented(0.5)
    ukf = InsUkf(options)
    belief = initial_ins_belief(options, d.start)
    alone = filtered(options, d)
    two = map_tree((belief, *d[2:]), lambda x: torch.stack((x, x)))
    with torch.no_grad():
        together = ukf(*two)
    for k in range(2):
        member = map_ins_belief(together.belief, lambda x: x[k])  # noqa: B023
        for a, b in zip(leaves(member), leaves(alone.belief), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-11)
    # what a car does while driving is the sequential form
    slow = filtered(options, d, "sequential")
    at, ready = belief, coning_compensated(d.samples)
    rests = ins_rest_at_end(ImuSample(*(x.unflatten(0, (10, 10)) for x in ready)))
    listening = torch.ones((), dtype=torch.float64)
    with torch.no_grad():
        for second in range(10):
            for k in range(10 * second, 10 * second + 10):
                at = ukf.step(at, ImuSample(*(x[k] for x in ready)))
            last = ImuSample(*(x[10 * second + 9] for x in d.samples))
            fix = GnssFix(*(x[second] for x in d.fixes))
            rest = type(rests)(*(x[second] for x in rests))
            at = ukf.update(at, fix, last, rest=rest, aided=listening)
    for a, b in zip(leaves(at)[:-1], leaves(slow.belief)[:-1], strict=True):
        torch.testing.assert_close(a, b[-1], rtol=1e-7, atol=1e-9)


def test_covariances_stay_positive(make_drive: Any) -> None:
    d = make_drive(seconds=40, rate=10)
    for alpha in (1.0, 1e-3):
        history = filtered(unscented(alpha, states=21), d)
        sigma = history.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
        scaled = history.belief.covariance / (sigma.unsqueeze(-1) * sigma.unsqueeze(-2))
        assert float(torch.linalg.eigvalsh(scaled).min()) > 0.0


def test_a_wild_fix_is_refused_and_a_filter_that_ran_away_begins_anew(make_drive: Any) -> None:
    d = make_drive(seconds=40, rate=10)
    options = unscented(0.5, gate=GateOptions(reset_after=3))
    wild = d.fixes.lat.clone()
    wild[20] += 200.0 / 6.4e6
    history = filtered(options, d._replace(fixes=d.fixes._replace(lat=wild)))
    assert int(history.verdict[20, InsKind.POSITION]) == Verdict.REFUSED_BY_GATE
    assert float(history.nis[20, InsKind.POSITION]) > 100.0
    away = torch.zeros(16, dtype=torch.float64)
    away[0] = 300.0
    lost = filtered(options, d, wrong=away)
    assert int(lost.resets[InsKind.POSITION]) == 1
    end = InsState(*(x[-1] for x in lost.trajectory))
    truth = InsState(*(x[-1] for x in d.truth))
    assert float(state_difference(end, truth)[:2].norm()) < 3.0


def test_doors(make_drive: Any) -> None:
    d = make_drive(seconds=6, rate=10)
    with pytest.raises(ConfigError, match="feedback closed"):
        InsUkf(InsEkfOptions(feedback="open"))
    with pytest.raises(ConfigError, match="take InsUkf"):
        InsEkf(unscented())
    with pytest.raises(ConfigError, match="step of InsUkf"):
        InsPredictor(unscented())
    with pytest.raises(ConfigError, match="choose exact, fast or sequential"):
        filtered(unscented(), d, "quick")
    with pytest.raises(ShapeError, match=r"samples\.f_b"):
        filtered(unscented(), d._replace(samples=d.samples._replace(f_b=d.samples.f_b[:-1])))
    assert type(ins_filter()) is InsEkf
    assert type(ins_filter(unscented())) is InsUkf
    assert InsUkf().weights == sigma_weights(UnscentedOptions(), 16)


def test_gradients_flow(make_drive: Any) -> None:
    """Derivatives of the innovations' squares by the noise, against differences."""
    d = make_drive(seconds=8, rate=10)
    options = unscented(0.5, gate=NO_GATE)
    ukf, belief = InsUkf(options), initial_ins_belief(options, d.start)

    def loss(log_noise: Tensor) -> Tensor:
        history = torch.func.functional_call(
            ukf, {"log_noise": log_noise}, (belief, d.samples, d.fixes, d.timing)
        )
        return history.nis.nansum() + 100.0 * history.trajectory.v_l[-1].sum()

    at = ukf.log_noise.detach().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(at), at)
    assert bool(torch.isfinite(gradient).all())
    g = torch.Generator().manual_seed(0)
    way = torch.randn(at.shape, generator=g, dtype=torch.float64)
    with torch.no_grad():
        step = 1e-4
        told = (loss(at + step * way) - loss(at - step * way)) / (2.0 * step)
    assert float(told) == pytest.approx(float((gradient * way).sum()), rel=1e-5)
    gradient = gradient.detach()
    for name in ("position_floor", "velocity_floor", "odometer_noise"):
        assert float(gradient[ukf.noise._fields.index(name)]) != 0.0
