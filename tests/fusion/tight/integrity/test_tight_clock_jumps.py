"""Clocks that jump, the receiver's or a system's, move no car."""

from typing import Any

import pytest
import torch

from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.options import RangeGateOptions

JUMP = 299792.458
"""A millisecond, m."""
EVERY = slice(None)


@pytest.mark.parametrize(
    ("jump", "visible"), [(JUMP, 8), (-JUMP, 4), (JUMP, 3), (JUMP, 2), (300.0, 8), (-300.0, 3)]
)
def test_a_clock_that_jumps_moves_no_car(spoil: Any, scene: Any, jump: float, visible: int) -> None:
    base = spoil.without(scene.drive.ranges, EVERY, slice(15, None), slice(visible, None))
    history, error = scene(spoil.changed(base, pseudorange=spoil.add(jump, EVERY, slice(30, None))))
    _, quiet = scene(base)
    assert history.resets.tolist() == [[0, 1]]
    assert bool((history.verdict[0, 30, :visible] == Verdict.ACCEPTED_BY_RESET).all())
    assert bool((history.verdict[0, 31:, :visible] != Verdict.REFUSED_BY_GATE).all())
    ahead = history.belief.clock[0, 31:, 0] - scene.drive.clock[0, 31:]
    assert float((ahead - jump).abs().max()) < 12.0
    # what the clock's history had told of the position goes; a jump itself moves nothing
    assert float((error - quiet)[:, :, :2].abs().max()) < (0.3 if visible == 8 else 1.5)
    spread = history.belief.covariance[0, 30].diagonal()[:2].sqrt()
    assert bool((spread <= history.prior.covariance[0, 30].diagonal()[:2].sqrt()).all())


def test_the_only_satellite_is_waited_for(spoil: Any, scene: Any) -> None:
    base = spoil.without(scene.drive.ranges, EVERY, slice(15, None), slice(1, None))
    history, error = scene(spoil.changed(base, pseudorange=spoil.add(JUMP, EVERY, slice(30, None))))
    patience = RangeGateOptions().reset_after
    out = history.verdict[0, :, 0] == Verdict.REFUSED_BY_GATE
    assert out.nonzero().squeeze(-1).tolist() == list(range(30, 30 + patience))
    assert history.resets.tolist() == [[0, 1]]
    assert float((error - scene(base)[1]).abs().max()) < 0.5


def test_a_frequency_that_jumps(spoil: Any, scene: Any) -> None:
    t = torch.arange(60, dtype=torch.float64)
    ramp = (30.0 * (t - 29.5)).clamp(min=0.0)[:, None]
    ranges = spoil.changed(
        scene.drive.ranges,
        range_rate=spoil.add(30.0, EVERY, slice(30, None)),
        pseudorange=spoil.add(ramp, EVERY),
    )
    history, error = scene(ranges)
    assert history.resets.tolist() == [[0, 1]]
    assert float((error - scene.plain()[1]).abs().max()) < 0.3
    assert float(history.belief.clock[0, 31, 1] - scene.drive.drift[0, 31]) == pytest.approx(
        30, abs=1
    )


def test_a_system_whose_time_jumps(spoil: Any, scene: Any) -> None:
    ranges = spoil.changed(
        scene.drive.ranges, pseudorange=spoil.add(80.0, EVERY, slice(30, None), slice(1, None, 2))
    )
    history, error = scene(ranges)
    assert history.resets.tolist() == [[0, 1]]
    offset = history.belief.clock[0, :, 2]
    assert float(offset[29]) == pytest.approx(120.0, abs=4.0)
    assert float(offset[-1]) == pytest.approx(200.0, abs=4.0)
    assert float((error - scene.plain()[1])[..., :2].abs().max()) < 1.5


@pytest.mark.parametrize("shift", [3e7, -3e8])
def test_clocks_may_be_off_by_seconds_from_the_start(spoil: Any, scene: Any, shift: float) -> None:
    history, error = scene(spoil.changed(scene.drive.ranges, pseudorange=spoil.add(shift, EVERY)))
    assert int(history.resets.sum()) == 0
    assert float((error - scene.plain()[1]).abs().max()) < 1e-5
    history, error = scene(
        spoil.changed(
            scene.drive.ranges, pseudorange=spoil.add(shift, EVERY, EVERY, slice(1, None, 2))
        )
    )
    assert int(history.resets.sum()) == 0
    assert float((error - scene.plain()[1]).abs().max()) < 1e-5
