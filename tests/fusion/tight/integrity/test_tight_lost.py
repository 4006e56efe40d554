"""Filters that are lost find themselves, and stay sound whatever ranges hold."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import RangeGateOptions
from navlearn.fusion.tight.riss_vehicle import RissVehicle

EVERY = slice(None)


@pytest.mark.filterwarnings("ignore:tight filter:UserWarning")
@pytest.mark.parametrize("wrong", [150.0, 2000.0, 6000.0])
def test_a_lost_filter_is_found(scene: Any, wrong: float) -> None:
    start = scene.drive.start
    state = start.state._replace(lat=start.state.lat + wrong / 6.4e6)
    history, error = scene(start=start._replace(state=state))
    assert history.resets.tolist() == [[1, 0]]
    patience = RangeGateOptions().reset_after
    assert float(error[0, 20 * patience - 1, 1]) > 0.5 * wrong
    assert float(error[:, 300:, :2].abs().max()) < 4.0
    reset = (history.verdict == Verdict.ACCEPTED_BY_RESET).any(-1)[0].nonzero().squeeze(-1)
    assert reset.tolist() == [patience]


@pytest.mark.filterwarnings("ignore:tight filter:UserWarning")
def test_three_satellites_never_force_a_position(spoil: Any, scene: Any) -> None:
    start = scene.drive.start
    state = start.state._replace(lat=start.state.lat + 2000.0 / 6.4e6)
    ranges = spoil.without(scene.drive.ranges, EVERY, EVERY, slice(3, None))
    history, error = scene(ranges, start=start._replace(state=state))
    assert history.resets[0, 0] == 0
    assert float(error[0, :, 1].min()) > 1900.0
    # the fourth and fifth come: now it is lost no longer
    more = spoil.without(scene.drive.ranges, EVERY, slice(0, 40), slice(3, None))
    history, error = scene(more, start=start._replace(state=state))
    assert history.resets[0, 0] == 1
    assert float(error[0, -100:, :2].abs().max()) < 4.0


@pytest.mark.filterwarnings("ignore:tight filter:UserWarning")
def test_whatever_ranges_hold_the_filter_stays_sound(range_drive: Callable[..., Any]) -> None:
    """Forty drives of errors of every size, gaps, jumps and odd deviations, in both forms."""
    batch, count = 40, 20
    d = range_drive(seconds=count, batch=batch, seed=9)
    g = torch.Generator().manual_seed(1)

    def drawn(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=g, dtype=torch.float64)

    shape, r = (batch, count, 8), d.ranges
    sign = torch.sign(drawn(*shape) - 0.5)
    wild = torch.where(
        drawn(*shape) < 0.6 * drawn(batch, 1, 1), sign * 10 ** (8 * drawn(*shape)), 0
    )
    jump = torch.where(drawn(batch, 1, 1) < 0.3, 10 ** (9 * drawn(batch, 1, 1) - 1), 0.0)
    jump = jump * (torch.arange(count) >= 10).double()[:, None]
    fast = torch.where(drawn(*shape) < 0.6 * drawn(batch, 1, 1), 10 ** (5 * drawn(*shape)), 0.0)
    ranges = r._replace(
        has_range=(drawn(*shape) < drawn(batch, 1, 1)).double(),
        has_rate=(drawn(*shape) < drawn(batch, 1, 1)).double(),
        pseudorange=r.pseudorange + wild + jump,
        range_rate=r.range_rate + fast,
        cn0=r.cn0 - 20.0 * drawn(*shape),
        std_range=torch.where(drawn(*shape) < 0.3, 10 ** (4 * drawn(*shape) - 3), 0.0),
    )
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    loop = ekf(d.start, d.samples, ranges, d.timing)
    values = torch.linalg.eigvalsh(loop.belief.covariance)
    assert bool((values > 0.0).all())
    assert int((loop.verdict == Verdict.REFUSED_BY_GATE).sum()) > 500
    assert int(loop.resets.sum()) > 5
    at_once = ekf(d.start, d.samples, ranges, d.timing, method="fast")
    for one, other in zip(loop.trajectory[:2], at_once.trajectory[:2], strict=True):
        # passes may have gone round the Earth before they converged
        assert 6.4e6 * float(torch.sin(one - other).abs().max()) < 0.02
    assert torch.equal(loop.resets, at_once.resets)
    assert torch.equal(loop.verdict, at_once.verdict)
