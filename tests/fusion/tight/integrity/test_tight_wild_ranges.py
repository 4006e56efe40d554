"""Wild ranges and rates are refused and no others; satellites come and go."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import RangeGateOptions, TightEkfOptions
from navlearn.fusion.tight.riss_vehicle import RissVehicle

EVERY = slice(None)


def test_a_clean_drive_refuses_a_thousandth_and_resets_nothing(scene: Any) -> None:
    history, error = scene.plain()
    assert int((history.verdict == Verdict.REFUSED_BY_GATE).sum()) <= 4
    assert int(history.resets.sum()) == 0
    assert float(error[:, 200:, :2].square().mean().sqrt()) < 2.0


@pytest.mark.parametrize(
    ("size", "visible"), [(1e5, 8), (-1e5, 5), (1e5, 3), (200.0, 8), (-200.0, 3)]
)
def test_a_wild_range_is_refused_and_no_other(
    spoil: Any, scene: Any, size: float, visible: int
) -> None:
    base = spoil.without(scene.drive.ranges, EVERY, slice(15, None), slice(visible, None))
    span = slice(20, 45)
    wild, moved = scene(spoil.changed(base, pseudorange=spoil.add(size, EVERY, span, 2)))
    _, still = scene(spoil.changed(base, has_range=spoil.put(0.0, EVERY, span, 2)))
    assert bool((wild.verdict[0, span, 2] == Verdict.REFUSED_BY_GATE).all())
    assert int((wild.verdict == Verdict.REFUSED_BY_GATE).sum()) <= 25 + 2
    assert int(wild.resets.sum()) == 0
    # not a centimetre: what is refused is as if it were not there
    assert float((moved - still).abs().max()) < 1e-6
    # refused for long, it is taken at once when it comes to its senses
    assert int(wild.verdict[0, 45, 2]) == Verdict.ACCEPTED
    assert float(wild.belief.refused[0, 44, 2]) == 25.0
    assert float(wild.belief.refused[0, 45, 2]) == 0.0


def test_a_wild_rate_is_refused_and_its_range_is_not(spoil: Any, scene: Any) -> None:
    span = slice(20, 30)
    history, error = scene(
        spoil.changed(scene.drive.ranges, range_rate=spoil.add(15.0, EVERY, span, 5))
    )
    assert bool((history.verdict[0, span, 13] == Verdict.REFUSED_BY_GATE).all())
    assert bool((history.verdict[0, span, 5] == Verdict.ACCEPTED).all())
    assert float((error - scene.plain()[1]).abs().max()) < 0.3


def test_a_wild_range_from_the_first_on_does_not_set_the_clock(spoil: Any, scene: Any) -> None:
    history, error = scene(
        spoil.changed(scene.drive.ranges, pseudorange=spoil.add(1e5, EVERY, EVERY, 0))
    )
    assert bool((history.verdict[0, :, 0] == Verdict.REFUSED_BY_GATE).all())
    assert float((history.belief.clock[0, 5:, 0] - scene.drive.clock[0, 5:]).abs().max()) < 8.0
    assert float(error[:, 200:, :2].square().mean().sqrt()) < 2.0


def test_two_of_eight_reflected(spoil: Any, scene: Any) -> None:
    late = torch.tensor([40.0, 55.0]).double()
    span = slice(20, 50)
    history, error = scene(
        spoil.changed(scene.drive.ranges, pseudorange=spoil.add(late, EVERY, span, [2, 5]))
    )
    out = history.verdict[0, span] == Verdict.REFUSED_BY_GATE
    assert float(out[:, [2, 5]].double().mean()) > 0.95
    assert int(history.resets.sum()) == 0
    assert float(error[:, 400:, :2].square().mean().sqrt()) < 2.0


def test_satellites_come_and_go(scene: Any) -> None:
    g = torch.Generator().manual_seed(7)
    there = torch.rand(1, 60, 8, generator=g) < 0.5
    ranges = scene.drive.ranges._replace(has_range=there.double(), has_rate=there.double())
    nan = torch.where(there, scene.drive.ranges.pseudorange, torch.nan)
    history, error = scene(ranges._replace(pseudorange=nan))
    assert torch.equal(history.verdict[..., :8] == Verdict.ABSENT, ~there)
    assert torch.equal(torch.isnan(history.innovation), ~there)
    assert torch.equal(torch.isnan(history.nis[..., 8:]), ~there)
    assert int(history.resets.sum()) == 0
    assert float(error[:, 400:, :2].square().mean().sqrt()) < 2.5


@pytest.mark.filterwarnings("ignore:tight filter:UserWarning")
def test_all_satellites_wild_by_their_own_move_nothing(spoil: Any, scene: Any) -> None:
    """Every range wild by another amount, and another at every reception: dead reckoning."""
    g = torch.Generator().manual_seed(5)
    size = 1e4 * torch.randn(1, 30, 8, generator=g, dtype=torch.float64)
    span = slice(20, 50)
    ranges = spoil.changed(
        scene.drive.ranges,
        pseudorange=spoil.add(size, EVERY, span),
        has_rate=spoil.put(0.0, EVERY, span),
    )
    history, error = scene(ranges)
    _, none = scene(spoil.without(scene.drive.ranges, EVERY, span))
    assert history.resets[0, 0] == 0
    assert float((error - none)[:, : 50 * 20 - 1].abs().max()) < 0.5


def test_an_open_gate_takes_everything(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=5)
    wild = d.ranges.pseudorange.clone()
    wild[:, 3, 1] += 1e4
    options = TightEkfOptions(gate=RangeGateOptions(probability=1.0))
    ekf = TightEkf(RissVehicle(d.options), options, systems=2)
    history = ekf(d.start, d.samples, d.ranges._replace(pseudorange=wild), d.timing)
    assert bool((history.verdict == Verdict.ACCEPTED).all())
