"""When faults of fixes begin, how large they are and where they point: seeded draws."""

import math
from typing import NamedTuple

import numpy as np

from navlearn.logs.synthetic.draws import Array, generator
from navlearn.logs.synthetic.fault_options import Biases, Fault, FaultOptions, Freezes, Ramps

TYPICAL = 2.0
"""A pause between fixes counts as at most so many usual intervals: nothing fails in it."""

SINGULAR = {"spikes": "spike", "biases": "bias", "ramps": "ramp", "freezes": "freeze"}


class PlannedFault(NamedTuple):
    """One fault of a drive.

    Attributes:
        kind: ``spike``, ``bias``, ``ramp`` or ``freeze``.
        first: Its first fix.
        last: Its last fix.
        size: Largest horizontal size, m; zero for a freeze, which is as large as the car drives.
        azimuth: Where it points, rad, clockwise from north.
        up: 1.0 where it points upwards, too, −1.0 for downwards.
        options: What was asked for.
    """

    kind: str
    first: int
    last: int
    size: float
    azimuth: float
    up: float
    options: Fault


def planned_faults(t: Array, options: FaultOptions) -> list[PlannedFault]:
    """Return the faults of a drive, in order of time, none overlapping another.

    Beginnings are those of a Poisson process per kind; one that comes before the fault before it
    is over, and has been for ``options.apart``, is left out.

    Args:
        t: Times of the fixes, s, increasing, shape (N,).
        options: What is to go wrong.
    """
    drawn = [one for name, fault in options.named() for one in _of_kind(t, name, fault, options)]
    kept: list[PlannedFault] = []
    for one in sorted(drawn, key=lambda fault: fault.first):
        if not kept or (
            one.first > kept[-1].last and t[one.first] >= t[kept[-1].last] + options.apart
        ):
            kept.append(one)
    return kept


def _of_kind(t: Array, name: str, fault: Fault, options: FaultOptions) -> list[PlannedFault]:
    """Return all that would happen of one kind; draws of a fault do not depend on the others."""
    if t.size < 2:
        return []
    step = np.diff(t)
    waited = np.concatenate(([0.0], np.minimum(step, TYPICAL * float(np.median(step)))))
    chance = 1.0 - np.exp(-fault.per_hour / 3600.0 * waited)
    begins = generator(options.seed, f"faults/{name}/begin").random(t.size) < chance
    begins &= t >= t[0] + options.settle
    rng = generator(options.seed, f"faults/{name}/shape")
    shapes = rng.random((t.size, 4))
    return [_fault(t, int(k), name, fault, shapes[k]) for k in np.flatnonzero(begins)]


def _fault(t: Array, first: int, name: str, fault: Fault, shape: Array) -> PlannedFault:
    size = 0.0 if isinstance(fault, Freezes) else _one_of(fault.sizes, shape[0])
    last = first
    if isinstance(fault, Biases | Ramps | Freezes):
        end = t[first] + _one_of(fault.durations, shape[1])
        last = max(first, int(np.searchsorted(t, end)) - 1)
    return PlannedFault(
        kind=SINGULAR[name],
        first=first,
        last=last,
        size=size,
        azimuth=2.0 * math.pi * float(shape[2]),
        up=1.0 if shape[3] < 0.5 else -1.0,
        options=fault,
    )


def _one_of(values: tuple[float, ...], share: float) -> float:
    return values[min(int(share * len(values)), len(values) - 1)]
