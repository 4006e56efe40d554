"""The clock of a receiver: an offset that its frequency drives.

White frequency noise walks the offset, a random walk the frequency: the two-state model of
[Groves2013] §9.4.2, drawn exactly at the receptions.
"""

import math
from typing import NamedTuple

import numpy as np

from navlearn.gnss.signals import SPEED_OF_LIGHT
from navlearn.logs.synthetic.draws import Array, generator
from navlearn.logs.synthetic.satellite_options import SatelliteOptions


class ReceiverClock(NamedTuple):
    """A receiver's clock at M receptions, shape (M,) each.

    Attributes:
        offset: How far it is ahead, times the speed of light, m.
        rate: How fast it gains, m/s, without white noise and without steps.
    """

    offset: Array
    rate: Array


def receiver_clock(count: int, dt: float, *, options: SatelliteOptions, seed: int) -> ReceiverClock:
    """Return the clock of a receiver.

    Args:
        count: Number of receptions M.
        dt: Time between them, s.
        options: Figures of the clock.
        seed: Seed of the simulation.
    """
    walk = options.clock_walk
    # Covariance of what the walk of the frequency does to offset and rate in one interval.
    factor = np.linalg.cholesky(np.array(((dt**2 / 3.0, 0.5 * dt), (0.5 * dt, 1.0))))
    drawn = generator(seed, "ranges/clock_walk").standard_normal((max(count - 1, 0), 2))
    driven = drawn @ factor.T * (walk * math.sqrt(dt))
    white = generator(seed, "ranges/clock_white").standard_normal(max(count - 1, 0))
    rate = options.clock_rate + np.concatenate(([0.0], np.cumsum(driven[:, 1])))
    steps = rate[:-1] * dt + driven[:, 0] + white * (options.clock_white * math.sqrt(dt))
    offset = options.clock + np.concatenate(([0.0], np.cumsum(steps)))
    return ReceiverClock(_steered(offset, options.clock_jump), rate)


def _steered(offset: Array, jump: float) -> Array:
    if jump <= 0.0:
        return offset
    step, taken = jump * SPEED_OF_LIGHT, 0.0
    steered = np.empty_like(offset)
    for k, value in enumerate(offset):
        if abs(value - taken) > 0.5 * step:
            taken += step * round((value - taken) / step)
        steered[k] = value - taken
    return steered
