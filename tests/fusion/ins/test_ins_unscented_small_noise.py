"""The unscented filter of a full IMU is the extended one to first order."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.filters_of import ins_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.layout import belief_difference, moved_belief
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.states import GnssFix, ImuSample, InsState

NO_GATE = GateOptions(probability=1.0)


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


@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_is_the_extended_filter_for_small_noise(make_drive: Any, alpha: float) -> None:
    """Estimates differ in the second order of deviations: half of these, a quarter in metres."""
    d = make_drive(seconds=12, rate=20)
    moved = []
    for scale in (0.1, 0.05):
        points = small(scale, alpha)
        linear = replace(points, unscented=None)
        belief = initial_ins_belief(points, d.start)
        wrong = -0.7 * belief.covariance.diagonal().sqrt()
        wrong[9:] = 0.0
        quiet = d._replace(samples=clean(d.samples), fixes=near(d, scale), start=d.start)
        one, other = (filtered(o, quiet, wrong=wrong) for o in (points, linear))
        gap = belief_difference(one.belief, other.belief)
        moved.append(gap.abs().amax(0))
        sigma = other.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
        assert float((gap / sigma).abs().max()) < 2.0 * scale
    shown = moved[0] > 1e-8
    ratio = (moved[0] / moved[1])[shown]
    assert int(shown.sum()) >= 6
    assert 3.3 < float(ratio.median()) < 4.7


def small(scale: float, alpha: float | None) -> InsEkfOptions:
    noise = InsNoiseOptions()
    walks = {
        name: scale * getattr(noise, name)
        for name in noise.__dataclass_fields__
        if not name.endswith("inflation") and name != "turn_noise"
    }
    start = InsInitialOptions()
    initial = {name: scale * getattr(start, name) for name in start.__dataclass_fields__}
    return unscented(
        alpha,
        gate=NO_GATE,
        noise=replace(noise, turn_noise=0.0, **walks),
        initial=InsInitialOptions(**initial),
    )


def clean(samples: ImuSample) -> ImuSample:
    return samples._replace(
        omega_ib_b=samples.omega_ib_b - torch.tensor([0.001, -0.002, 0.0015]).double(),
        f_b=samples.f_b - torch.tensor([0.02, -0.03, 0.04]).double(),
        speed=samples.speed / 1.01,
    )


def near(d: Any, scale: float) -> GnssFix:
    """Fixes without errors, as accurate as they should be at that scale."""
    at = d.timing.index
    fixes = d.fixes._replace(**{k: scale * getattr(d.fixes, k) for k in STATED})
    truth = InsState(*(x[at] for x in d.truth))
    told = (truth.lat, truth.lon, truth.height, *truth.v_l.unbind(-1))
    exact: GnssFix = GnssFix(*told, *fixes[6:])
    return exact


STATED = ("std_e", "std_n", "std_u", "std_v")
