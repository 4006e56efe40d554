"""Has a fix moved as the car did? T_GNSS of [Ghouneem2024] Eq. (24), against the odometer.

As printed a fix is compared with the one before, whatever became of that, as if the car stood:
every fast drive is refused, and so is the first good fix after an outlier. Here the way between two
fixes is compared with that reckoned from odometer and gyro, and the earlier of the two is the last
that this test believed. Should that one have been wrong, the fixes after it would be refused in its
stead: one that surely agrees with the fix believed before it is believed, too, and the last
forgotten.

Odometer and gyro tell the shape of a way, not where it leads. That is taken from fixes believed
earlier: from one far enough back that the chord to the reference tells a direction, and near enough
that the gyro's drift does not matter. Where there is none, two distances are compared, which shows
less: a fix may then lie anywhere on a circle. The azimuth of the filter would tell the direction,
too, but so the verdicts hang on samples and fixes alone, are the same in all forms of a filter, and
stay right where the filter has run away and its own prediction refuses good fixes.

What is allowed grows with the way, not with time: scale factor and gyro drift spoil a reckoned way
in proportion to it, and a parked car's fix may not wander however long it stands.
"""

import numpy as np
import torch
from torch import Tensor

from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.seen_fixes import Carriage, Seen, metres_per_radian, reckoned_antenna
from navlearn.states import FixTiming, GnssFix

MEMORY = 32
"""How many believed fixes before the last are looked at for it."""


@torch.no_grad()
def astray(
    gate: GateOptions,
    arm: tuple[float, float],
    carriage: Carriage,
    fixes: GnssFix,
    timing: FixTiming,
) -> Tensor:
    """Return which fixes have moved otherwise than the car.

    The first fix is believed, and so is one after ``reset_after`` refusals in a row. Without an
    odometer between them two fixes are not compared.

    Args:
        gate: Limits.
        arm: Antenna from the point whose speed the odometer tells, right and forward, m.
        carriage: The car's motion, shape (B, T) each.
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.

    Returns:
        1.0 where a fix is refused, shape (B, M).
    """
    found = torch.zeros_like(fixes.lat)
    if not gate.tests_motion or timing.index.shape[-1] == 0:
        return found
    radii = metres_per_radian(fixes)
    there = (timing.index >= 0) & (fixes.has_position > 0.5)
    for b in range(len(found)):
        use = there[b].cpu().numpy()
        if not use.any():
            continue
        row = [channel[b].cpu().numpy() for channel in carriage]
        index, delay = (x[b].cpu().numpy()[use] for x in timing)
        places = [x[b].cpu().numpy()[use] for x in (fixes.lat, fixes.lon, *radii)]
        seen = Seen(*places, *reckoned_antenna(row, arm, index, delay))
        refused = _refused(gate, seen)
        found[b, torch.from_numpy(np.flatnonzero(use)).to(found.device)] = found.new_tensor(refused)
    return found


def _refused(gate: GateOptions, seen: Seen) -> list[float]:
    count = len(seen.lat)
    later = np.arange(1, count)
    if gate.motion_reference == "none":
        moved = np.abs(seen.moved(later - 1, later))
        return [0.0, *(~(moved <= gate.motion_limit)).astype(float).tolist()]
    base = _latest_base(seen, later)
    wild = ~(seen.contradiction(later - 1, later, base) <= seen.allowed(gate, later - 1, later))
    if not wild.any():
        return [0.0] * count
    return _in_turn(gate, seen, wild.tolist())


def _latest_base(seen: Seen, later: np.ndarray) -> np.ndarray:
    """Return which fix directs the way from each fix to the next, −1 for none."""
    base = np.full(len(later), -1)
    for lag in range(1, MEMORY + 1):
        first = later - 1 - lag
        here = (first >= 0) & (base < 0)
        here &= seen.directs(np.maximum(first, 0), later - 1, later)
        base[here] = first[here]
    return base


def _in_turn(gate: GateOptions, seen: Seen, wild: list[bool]) -> list[float]:
    """Return which fixes are refused, one after another.

    ``wild`` tells which contradict the one before, if all before them are believed: that holds
    again where those that may direct the way have been believed without a gap.
    """
    refused = [0.0] * len(seen.lat)
    past, waited, since = [0], 0, 0
    for k in range(1, len(seen.lat)):
        unbroken = since == 0 or k - since > MEMORY + 1
        if unbroken and not wild[k - 1]:
            past.append(k)
            continue
        agreeing = next(
            (n for n in (1, 2) if n <= len(past) and _agrees(gate, seen, past, n, k)), 0
        )
        if agreeing == 1:
            past.append(k)
            waited = 0
        elif agreeing == 2:
            # the fix before the last agrees and the last does not: that one was wrong
            past[-1] = k
            waited, since = 0, k
        elif waited < gate.reset_after:
            refused[k], waited, since = 1.0, waited + 1, k + 1
        else:
            past, waited, since = [k], 0, k
    return refused


def _agrees(gate: GateOptions, seen: Seen, past: list[int], back: int, k: int) -> bool:
    """Return whether a fix agrees with one believed before it, ``back`` from the end."""
    a, b = np.array(past[-back]), np.array(k)
    tried = np.array(past[-back - 1 : -back - 1 - MEMORY : -1], dtype=int)
    able = tried[seen.directs(tried, a, b)] if len(tried) > 0 else tried
    base = able[0] if len(able) > 0 else np.array(-1)
    off = seen.contradiction(a, b, base, most=back > 1)
    return bool(off <= seen.allowed(gate, a, b))
