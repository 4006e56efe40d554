"""The record of a free INS beside its fixes, and how its rows are divided."""

import pytest
import torch

from navlearn.errors import ConfigError, FitError, ShapeError
from navlearn.learning.position_series import (
    SERIES_INPUTS,
    position_series,
    series_inputs,
    without_fixes_after,
)
from navlearn.learning.position_windows import (
    RowSplit,
    assign_parts,
    free_run_windows,
    open_loop_windows,
    part_of,
)

NAMES = tuple(SERIES_INPUTS)


def record(length=60, every=10, drop=(), scale=1.0):
    t = torch.arange(length, dtype=torch.float64) / 10.0
    ins = torch.stack((t**2, 3.0 * t, 1e6 + t), -1)
    index = torch.tensor([k for k in range(0, length, every) if k not in drop])
    offset = scale * torch.arange(len(index), dtype=torch.float64).unsqueeze(1)
    return position_series(t, ins, index, ins[index] + offset)


def test_target_is_reference_less_ins_and_lies_on_lines_between_fixes():
    series = record()
    assert torch.allclose(series.target[10], torch.ones(3, dtype=torch.float64), atol=1e-9)
    assert torch.allclose(series.target[13, 0], torch.tensor(1.3, dtype=torch.float64))
    assert series.at_fix.nonzero().squeeze(-1).tolist() == [0, 10, 20, 30, 40, 50]
    assert series.delay[[9, 10, 11, 25]].tolist() == [9.0, 0.0, 1.0, 5.0]
    assert torch.equal(series.held[19], series.held[10])
    # Nothing is known after the last fix: no target may be learned there.
    assert int(series.known.sum()) == 51
    assert torch.equal(series.target[59], series.target[50])


def test_record_begins_with_the_first_fix_and_the_last_of_several_counts():
    t = torch.arange(20, dtype=torch.float64)
    ins = torch.zeros(20, 3, dtype=torch.float64)
    index = torch.tensor([4, 8, 8, 12])
    fix = torch.arange(4, dtype=torch.float64).unsqueeze(1).expand(4, 3)
    series = position_series(t, ins, index, fix)
    assert float(series.t[0]) == 4.0
    assert series.target[4, 0] == 2.0
    assert series.held[4, 0] == 2.0


def test_missed_fixes_lengthen_the_delay():
    assert int(record().delay.max()) == 9
    assert int(record(drop=(20,)).delay.max()) == 19


def test_a_row_is_told_nothing_that_comes_with_its_own_fix():
    plain, other = record(), record(scale=7.0)
    made = [open_loop_windows(s, 0, NAMES, RowSplit()) for s in (plain, other)]
    # Row 9 has the target of sample 10, where a fix is; its inputs are those of sample 9.
    assert made[0].row[0, 9] == 10
    assert made[0].windows.y[0, 9, 0] != made[1].windows.y[0, 9, 0]
    assert torch.equal(made[0].windows.u[0, 9], made[1].windows.u[0, 9])
    assert made[0].windows.u[0, 9, 2] == 9.0


def test_withheld_fixes_are_gone_from_inputs():
    series = record()
    gone = without_fixes_after(series, 20)
    poisoned = series._replace(held=series.held.clone())
    poisoned.held[21:] = torch.nan
    again = without_fixes_after(poisoned, 20)
    u = series_inputs(again, 1, NAMES)
    assert torch.equal(u, series_inputs(gone, 1, NAMES))
    assert bool(torch.isfinite(u).all())
    assert u[59, 2] == 39.0
    assert not bool(gone.known[21:].any())


def test_random_split_differs_from_split_by_time():
    start = torch.arange(1000)
    by_time = assign_parts(start, 1, RowSplit("time", gap=20))
    drawn = assign_parts(start, 1, RowSplit("random", seed=3))
    assert (by_time.diff() < 0).sum() == 2  # into either gap, and nowhere else
    assert (by_time == -1).sum() == 40
    assert [int((drawn == k).sum()) for k in range(3)] == [700, 150, 150]
    # The leak: nearly every test row has a training row beside it, and by time none has.
    test = (drawn == 2).nonzero().squeeze(-1)
    test = test[(test > 0) & (test < 999)]
    beside = (drawn[test - 1] == 0) | (drawn[test + 1] == 0)
    assert beside.double().mean() > 0.85
    test = (by_time == 2).nonzero().squeeze(-1)
    assert (by_time[test - 20] != 0).all()
    assert not torch.equal(drawn, assign_parts(start, 1, RowSplit("random", seed=4)))
    assert torch.equal(drawn, assign_parts(start, 1, RowSplit("random", seed=3)))


def test_windows_by_time_do_not_overlap():
    start = torch.arange(0, 400, 10)
    part = assign_parts(start, 50, RowSplit("time", gap=10))
    for one, two in ((0, 1), (1, 2)):
        assert int(start[part == one].max()) + 50 + 10 <= int(start[part == two].min())


def test_free_runs_begin_after_fixes_and_every_second_has_none():
    series = record(length=400)
    made = free_run_windows(
        series, 0, NAMES, RowSplit(), length=30, stride=20, warmup=1, fixes_only=True
    )
    first = made.row[:, 1]  # after one row of warm-up
    assert bool(series.at_fix[first - 1].all())
    delay = made.windows.u[:, 1:, 2]
    assert float(delay[::2].max()) == 9.0
    assert torch.equal(delay[1], torch.arange(30).double())
    assert torch.equal(made.windows.weight[:, 1:].bool(), series.at_fix[made.row[:, 1:]])
    assert bool((made.windows.weight[:, 0] == 0).all())
    trains, tests = part_of(made, 0), part_of(made, 2)
    assert not set(trains.start_time.tolist()) & set(tests.start_time.tolist())


def test_what_cannot_be_used_is_refused():
    t, ins = torch.arange(5.0).double(), torch.zeros(5, 3).double()
    with pytest.raises(FitError, match="two or more"):
        position_series(t, ins, torch.tensor([1, 1]), torch.zeros(2, 3).double())
    with pytest.raises(ShapeError, match="fixes at samples"):
        position_series(t, ins, torch.tensor([1, 5]), torch.zeros(2, 3).double())
    with pytest.raises(ShapeError, match="expected"):
        position_series(t, ins[:4], torch.tensor([1, 2]), torch.zeros(2, 3).double())
    with pytest.raises(ConfigError, match="choose from"):
        series_inputs(record(), 0, ("speed",))
    with pytest.raises(ConfigError, match="is not one of"):
        assign_parts(torch.arange(9), 1, RowSplit("odd"))
    with pytest.raises(FitError, match="leave"):
        free_run_windows(record(), 0, NAMES, RowSplit(), length=40, stride=5, warmup=0)
