"""Placing messages that arrive with jitter by the exact epoch that they carry."""

import numpy as np
import numpy.typing as npt

from navlearn.logs.interval_means import FloatArray

_BURST = 0.3


def rows_of_epochs(epoch_t: FloatArray, message_t: FloatArray) -> npt.NDArray[np.int64]:
    """Return which message belongs to each epoch: the nearest of the same burst.

    Args:
        epoch_t: Arrival of the messages that carry the epoch, s, increasing, shape (M,).
        message_t: Arrival of the other messages, s, increasing, shape (K,).

    Returns:
        Row of the message, −1 where none arrived within 0.3 s, shape (M,).
    """
    if message_t.size == 0:
        return np.full(epoch_t.size, -1)
    after = np.clip(np.searchsorted(message_t, epoch_t), 1, max(message_t.size - 1, 1))
    after = np.minimum(after, message_t.size - 1)
    before = np.maximum(after - 1, 0)
    nearer_before = epoch_t - message_t[before] <= message_t[after] - epoch_t
    row = np.where(nearer_before, before, after)
    return np.where(np.abs(message_t[row] - epoch_t) < _BURST, row, -1)


def clock_from_epochs(epoch: FloatArray, arrival: FloatArray) -> tuple[FloatArray, float]:
    """Return the epochs on the logger's clock, without the jitter of their arrival.

    The delay of arrival is a straight line in time: the two clocks drift apart by tens of parts
    per million. The line is fitted to all arrivals by least absolute deviations (reweighted
    least squares), so stragglers do not move it. Only stamps are used, never what was measured.

    Args:
        epoch: Exact epochs, s, on the receiver's clock, shape (M,).
        arrival: When each was received, s, on the logger's clock, shape (M,).

    Returns:
        Times on the logger's clock, s, shape (M,), and the drift of the logger's clock, s/s.
    """
    # Receivers print the epoch a millisecond early or late.
    since = np.round(epoch - epoch[0], 2)
    if since.size < 3 or since[-1] <= 0.0:
        return since + float(np.median(arrival - since)), 0.0
    design = np.stack((np.ones_like(since), since / since[-1]), axis=1)
    delay = arrival - since
    weight = np.ones_like(delay)
    line = np.zeros(2)
    for _ in range(30):
        scaled = design * weight[:, None]
        line = np.linalg.solve(scaled.T @ design, scaled.T @ delay)
        weight = 1.0 / np.maximum(np.abs(delay - design @ line), 1e-3)
    return since + design @ line, float(line[1] / since[-1])
