import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from navlearn.errors import ConfigError, FitError, ShapeError
from navlearn.learning.windows import (
    Windows,
    check_windows,
    select_windows,
    split_windows,
    windows_from_series,
)


def some_windows(count=20, rows=6):
    u = torch.arange(count * rows * 2, dtype=torch.float64).reshape(count, rows, 2)
    times = 10.0 * torch.arange(count).double()
    return Windows(u, u[..., :1].clone(), torch.ones(count, rows).double(), times)


def test_windows_of_a_series_hold_what_the_series_holds():
    u = torch.arange(50, dtype=torch.float64).reshape(50, 1)
    y = 100.0 + u
    windows = windows_from_series(u, y, length=5, stride=4, warmup=2, start_time=3.0, time_step=0.5)
    for k in range(windows.u.shape[0]):
        first = 1 + 4 * k
        assert windows.u[k, :, 0].tolist() == list(range(first, first + 7))
        assert windows.y[k, :, 0].tolist() == list(range(100 + first, 107 + first))
        assert windows.y_start[k].tolist() == [100.0 + first - 1]
        assert float(windows.start_time[k]) == 3.0 + 0.5 * first
    assert int(windows.u[-1, -1]) <= 49
    assert int(windows.u[-1, -1]) + 4 > 49
    assert windows.weight[:, :2].sum() == 0
    assert bool((windows.weight[:, 2:] == 1).all())


@pytest.mark.parametrize("gap", [0.0, 25.0])
def test_split_by_time_keeps_the_gap(gap):
    windows = some_windows()
    shuffled = select_windows(windows, torch.randperm(20))
    train, valid = split_windows(shuffled, duration=6.0, valid_fraction=0.3, gap=gap)
    assert valid.u.shape[0] == 6
    assert float(valid.start_time.min()) - float(train.start_time.max() + 6.0) >= gap
    following = float(train.start_time.max()) + 10.0
    assert following + 6.0 + gap > float(valid.start_time.min())


def test_overlapping_windows_do_not_straddle_the_split():
    windows = some_windows()._replace(start_time=torch.arange(20).double())
    train, valid = split_windows(windows, duration=6.0, valid_fraction=0.25)
    assert float(train.start_time.max()) + 6.0 <= float(valid.start_time.min())


def test_random_split_exists_under_its_own_name_only():
    windows = some_windows()
    train, valid = split_windows(
        windows, duration=6.0, valid_fraction=0.3, split="random_jaradat2017", seed=4
    )
    assert sorted([*train.start_time.tolist(), *valid.start_time.tolist()]) == (
        windows.start_time.tolist()
    )
    assert float(train.start_time.max()) > float(valid.start_time.min())
    again, _ = split_windows(
        windows, duration=6.0, valid_fraction=0.3, split="random_jaradat2017", seed=4
    )
    assert torch.equal(again.u, train.u)
    with pytest.raises(ConfigError, match="split 'random'"):
        split_windows(windows, duration=6.0, split="random")


def test_split_refuses_to_leave_nothing():
    with pytest.raises(FitError, match="leave none for training"):
        split_windows(some_windows(3), duration=6.0, gap=100.0)
    with pytest.raises(ConfigError, match="valid_fraction"):
        split_windows(some_windows(), duration=6.0, valid_fraction=1.0)


def test_checking_fills_the_start_and_turns_to_float64():
    windows = some_windows()
    checked = check_windows(windows._replace(u=windows.u.float()))
    assert checked.u.dtype == torch.float64
    assert torch.equal(checked.y_start, torch.zeros(20, 1).double())


def spoil(field, value):
    windows = some_windows()
    spoiled = getattr(windows, field).clone()
    spoiled.reshape(-1)[31 % spoiled.numel()] = value
    return windows._replace(**{field: spoiled})


@pytest.mark.parametrize(
    ("windows", "error", "said"),
    [
        (spoil("u", torch.nan), FitError, r"u holds 1 values .* index \(2, 3, 1\)"),
        (spoil("y", torch.inf), FitError, r"y holds 1 values .* index \(5, 1, 0\)"),
        (spoil("weight", -1.0), FitError, "a weight is negative"),
        (spoil("weight", torch.nan), FitError, "weight holds 1 values"),
        (some_windows()._replace(y=torch.zeros(20, 5, 1)), ShapeError, "expected"),
        (some_windows()._replace(u=torch.zeros(20, 6)), ShapeError, "expected"),
        (some_windows()._replace(weight=torch.ones(20)), ShapeError, "weight has shape"),
        (some_windows()._replace(y_start=torch.ones(20)), ShapeError, "y_start has shape"),
        (some_windows()._replace(warmup=6), ShapeError, "warmup is 6"),
        (some_windows()._replace(weight=torch.zeros(20, 6)), FitError, "no row counts"),
    ],
)
def test_bad_windows_are_refused(windows, error, said):
    with pytest.raises(error, match=said):
        check_windows(windows)


def test_a_short_series_is_refused():
    with pytest.raises(ShapeError, match="holds no window of 10 rows"):
        windows_from_series(torch.zeros(10, 1), torch.zeros(10, 1), length=8, warmup=2, stride=1)
    with pytest.raises(ShapeError, match=r"\(T, m\) and \(T, p\)"):
        windows_from_series(torch.zeros(10, 1), torch.zeros(9, 1), length=2, stride=1)


@given(
    field=st.sampled_from(["u", "y", "weight"]),
    value=st.sampled_from([torch.nan, torch.inf, -torch.inf]),
    place=st.integers(0, 119),
)
def test_what_is_not_finite_is_found_wherever_it_is(field, value, place):
    windows = some_windows()
    spoiled = getattr(windows, field).clone()
    spoiled.reshape(-1)[place] = value
    with pytest.raises(FitError, match=f"windows: {field} holds 1 values that are not finite"):
        check_windows(windows._replace(**{field: spoiled}))


@given(
    count=st.integers(2, 30),
    duration=st.floats(1.0, 200.0),
    gap=st.floats(0.0, 50.0),
    share=st.floats(0.05, 0.95),
)
def test_a_split_by_time_never_leaks(count, duration, gap, share):
    windows = some_windows(count)
    try:
        train, valid = split_windows(windows, duration=duration, valid_fraction=share, gap=gap)
    except FitError:
        return
    ends = train.start_time + duration
    assert float(ends.max()) + gap <= float(valid.start_time.min()) + 1e-6
    kept = [*train.start_time.tolist(), *valid.start_time.tolist()]
    assert len(set(kept)) == len(kept)
