"""Emulated outages of the past, and the gate that judges by them."""

from collections.abc import Callable

import pytest
import torch

from navlearn.experiment.range_error_gate import judged, past_of, replayed
from navlearn.experiment.range_error_replays import (
    one_of,
    recent_replays,
    rms_error,
    run_replays,
)
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.tight_navigator import tight_belief_at

MakeSpec = Callable[..., RangeErrorSpec]
Highest = Callable[[DriveLog, int], Outage]


def test_emulated_outages_are_the_filter_run_on(
    spec: MakeSpec, highest: Highest, systematic: DriveLog, runs: TightFilterRuns
) -> None:
    """With every satellite left, nothing is lost; with some, a batch equals one by one."""
    outage = highest(systematic, 2)
    start = runs.before(known_log(systematic, outage), outage)
    past, model = past_of(start), spec()
    names = start.series.satellites
    visible = torch.tensor([name in outage.satellites_visible for name in names])
    absent = visible.clone()
    absent[int((past.heard.ranges.has_range > 0.5).sum(0).argmin())] = True
    never = past.heard._replace(
        ranges=past.heard.ranges._replace(
            has_range=torch.where(absent, 0.0, past.heard.ranges.has_range)
        )
    )
    assert recent_replays(start.run, never, absent, model) is None
    replays = recent_replays(start.run, past.heard, visible, model)
    assert replays is not None
    whole = replays.ranges._replace(
        has_range=past.heard.ranges.has_range[replays.reception.clamp(min=0)],
        has_rate=past.heard.ranges.has_rate[replays.reception.clamp(min=0)],
    )
    again = run_replays(start.navigator, start.run, replays, whole)
    assert float(rms_error(again.trajectory, replays.reference).max()) < 1e-6
    starts = start.run.history.end[replays.block]
    assert bool((torch.diff(starts) >= 300).all())
    assert int(starts[-1]) + 300 < len(start.run.samples.dt)
    some = run_replays(start.navigator, start.run, replays, replays.ranges)
    assert float(rms_error(some.trajectory, replays.reference).min()) > 1e-3
    alone = start.navigator.filter_on(
        tight_belief_at(start.run.history, int(replays.block[1])),
        one_of(replays.samples, 1),
        one_of(replays.ranges, 1),
        one_of(replays.timing, 1),
    )
    torch.testing.assert_close(alone.trajectory.lat, some.trajectory.lat[1], rtol=0.0, atol=1e-13)


def test_the_gate_looks_at_errors_with_and_without(
    spec: MakeSpec, highest: Highest, systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = highest(systematic, 3)
    start = runs.before(known_log(systematic, outage), outage)
    past = past_of(start)
    visible = torch.tensor([n in outage.satellites_visible for n in start.series.satellites])
    model = spec("decay")
    replays = recent_replays(start.run, past.heard, visible, model)
    assert replays is not None
    better, plain = replayed(start, past, replays, visible, model)
    verdict = judged(start, past, visible, model)
    assert verdict.replays == len(better)
    assert verdict.improvement == pytest.approx(1.0 - float(better.sum() / plain.sum()))
    assert not judged(start, past, visible, spec("decay", gate_horizon_s=300.0)).use
