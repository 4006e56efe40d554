"""Chooses starts that keep their distance from each other out of many good ones.

Pure functions on a sorted array of candidate starts; ``separation`` is the least time from one
start to the next.
"""

from collections.abc import Sequence

import numpy as np

from navlearn.outages.track import Array


def first_that_fit(starts: Array, separation: float, count: int | None = None) -> Array:
    """Return starts taken greedily from the left, each at least a separation after the last.

    No other choice holds more starts.

    Args:
        starts: Candidates, s, sorted, shape (K,).
        separation: Least time between two, s.
        count: Stop after so many.
    """
    chosen: list[float] = []
    position = 0
    while position < starts.size and (count is None or len(chosen) < count):
        chosen.append(float(starts[position]))
        # A hair of slack: sums of seconds in floating point may fall short by one unit.
        position = int(np.searchsorted(starts, chosen[-1] + separation - 1e-9, side="left"))
    return np.array(chosen)


def spread_evenly(starts: Array, separation: float, count: int) -> Array:
    """Return starts whose least separation is as large as whole seconds allow.

    Args:
        starts: Candidates, s, sorted, shape (K,), which hold at least ``count``.
        separation: Least time between two, s.
        count: How many.
    """
    if count == 1:
        return starts[:1]
    low, high = 0, int((starts[-1] - starts[0]) / (count - 1) - separation) + 1
    while high - low > 1:
        middle = (low + high) // 2
        if first_that_fit(starts, separation + middle, count).size == count:
            low = middle
        else:
            high = middle
    return first_that_fit(starts, separation + low, count)


def draw(starts: Array, separation: float, count: int, seed: int) -> Array:
    """Return starts drawn at random, in order of time.

    A draw that would leave too little room for the rest is put back, so the count is always
    reached where it fits.

    Args:
        starts: Candidates, s, sorted, shape (K,), which hold at least ``count``.
        separation: Least time between two, s.
        count: How many.
        seed: Of the draw.
    """
    chosen: list[float] = []
    room = starts
    for candidate in np.random.default_rng(seed).permutation(starts):
        if len(chosen) == count:
            break
        if candidate not in room:
            continue
        rest = clear_of(room, [float(candidate)], separation)
        if len(chosen) + 1 + first_that_fit(rest, separation).size >= count:
            chosen.append(float(candidate))
            room = rest
    return np.sort(np.array(chosen))


def pick_per_class(
    starts: Array, labels: np.ndarray, classes: Sequence[str], separation: float, count: int
) -> tuple[Array, list[str]]:
    """Return starts taken from the classes in turn, each as far as can be from the others.

    Args:
        starts: Candidates, s, sorted, shape (K,).
        labels: Class of each, shape (K,).
        classes: Classes to take, in turn.
        separation: Least time between two, s.
        count: How many in all.

    Returns:
        Starts in order of time, fewer than ``count`` where no more fit; and the classes that
        no candidate had.
    """
    missing = [name for name in classes if not (labels == name).any()]
    wanted = [name for name in classes if name not in missing]
    chosen: list[float] = []
    while wanted and len(chosen) < count:
        for name in list(wanted):
            room = clear_of(starts[labels == name], chosen, separation)
            if room.size == 0:
                wanted.remove(name)
            elif len(chosen) < count:
                chosen.append(_farthest(room, chosen))
    return np.sort(np.array(chosen)), missing


def clear_of(starts: Array, taken: Sequence[float], separation: float) -> Array:
    """Return the candidates that keep their distance from all taken starts.

    Args:
        starts: Candidates, s, shape (K,).
        taken: Starts already chosen, s.
        separation: Least time between two, s.
    """
    for other in taken:
        starts = starts[np.abs(starts - other) >= separation - 1e-9]
    return starts


def _farthest(room: Array, chosen: Sequence[float]) -> float:
    if not chosen:
        return float(room[0])
    distance = np.abs(room[:, None] - np.array(chosen)[None, :]).min(axis=1)
    return float(room[int(distance.argmax())])
