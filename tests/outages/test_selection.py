import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.outages import selection

STARTS = st.lists(st.integers(0, 40), min_size=1, max_size=11, unique=True).map(
    lambda values: np.array(sorted(values), dtype=float)
)


def brute_force(starts: np.ndarray, count: int) -> float:
    """Largest least separation over all choices of so many starts."""
    return max(
        float(np.diff(choice).min()) if count > 1 else np.inf
        for choice in itertools.combinations(starts, count)
    )


@given(starts=STARTS, separation=st.integers(1, 12))
def test_greedy_choice_is_the_largest_there_is(starts: np.ndarray, separation: int) -> None:
    found = selection.first_that_fit(starts, separation)
    best = max(
        count for count in range(1, starts.size + 1) if brute_force(starts, count) >= separation
    )
    assert found.size == best
    assert (np.diff(found) >= separation).all()


@settings(deadline=None)
@given(starts=STARTS, separation=st.integers(1, 6), data=st.data())
def test_spread_has_the_largest_least_separation(
    starts: np.ndarray, separation: int, data: st.DataObject
) -> None:
    count = data.draw(st.integers(1, selection.first_that_fit(starts, separation).size))
    found = selection.spread_evenly(starts, separation, count)
    assert found.size == count
    if count > 1:
        assert float(np.diff(found).min()) == brute_force(starts, count)


@settings(deadline=None)
@given(starts=STARTS, separation=st.integers(1, 6), seed=st.integers(0, 5), data=st.data())
def test_drawn_starts_reach_the_count_whenever_it_fits(
    starts: np.ndarray, separation: int, seed: int, data: st.DataObject
) -> None:
    count = data.draw(st.integers(1, selection.first_that_fit(starts, separation).size))
    found = selection.draw(starts, separation, count, seed)
    assert found.size == count
    assert (np.diff(found) >= separation).all()
    assert np.isin(found, starts).all()
    assert np.array_equal(found, selection.draw(starts, separation, count, seed))


def test_draws_differ_by_seed() -> None:
    starts = np.arange(500.0)
    drawn = {tuple(selection.draw(starts, 20.0, 5, seed)) for seed in range(5)}
    assert len(drawn) == 5


def test_classes_take_turns_and_missing_ones_are_told() -> None:
    starts = np.arange(100.0)
    labels = np.where(starts < 50.0, "turn", "stop")
    found, missing = selection.pick_per_class(starts, labels, ("hill", "turn", "stop"), 10.0, 4)
    assert missing == ["hill"]
    assert (found < 50.0).sum() == 2
    assert (found >= 50.0).sum() == 2
    assert (np.diff(found) >= 10.0).all()


def test_classes_that_are_full_leave_their_turn_to_others() -> None:
    starts = np.arange(100.0)
    labels = np.where(starts == 0.0, "turn", "stop")
    found, _ = selection.pick_per_class(starts, labels, ("turn", "stop"), 20.0, 4)
    assert found.size == 4
    assert found[0] == 0.0
