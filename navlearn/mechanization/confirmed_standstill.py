"""Standstill that no fix contradicts: what an IMU alone took for one, checked against GNSS.

An IMU alone cannot tell a car that stands from one that glides along a perfectly smooth road, as
simulated cars do. So a standstill that no odometer vouches for is given up while the last fix says
that the car drove too fast to have stopped since, and altogether once fixes have shown that the
detector is often wrong on this drive. Only fixes up to each interval are looked at.
"""

import torch
from torch import Tensor

from navlearn.states import FixTiming, GnssFix, ImuSample

MOVING = 0.5
"""Speed at which a fix says that the car moves, m/s, if it is clear of the receiver's noise."""

HARDEST_BRAKING = 5.0
"""m/s²."""

TOLERATED = 0.05
"""Share of the fixes of a moving car at which the detector may have been wrong, ..."""

SLIPS = 2
"""... and how often it may be wrong whatever the share."""

FRESH = 2.0
"""How long a fix that says "still" vouches for a detector that is often wrong, s."""


def confirmed_standstill(samples: ImuSample, fixes: GnssFix, timing: FixTiming) -> ImuSample:
    """Return samples whose ``stationary`` no fix contradicts.

    Args:
        samples: Intervals of one drive, shape (T,) and (T, 3) each.
        fixes: Fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.

    Returns:
        The samples; ``stationary`` is 0 where fixes contradict it and no odometer vouches for it.
    """
    told = torch.nonzero((timing.index >= 0) & (fixes.has_velocity > 0))[:, 0]
    alone = (samples.stationary > 0.5) & (samples.has_speed < 0.5)
    if len(told) == 0 or not bool(alone.any()):
        return samples
    at = timing.index[told]
    speed = torch.hypot(fixes.v_e[told], fixes.v_n[told])
    noise = fixes.std_v[told]
    moving = speed > (4.0 * noise).clamp(min=MOVING)
    wrong = torch.cumsum(moving & alone[at], 0)
    unreliable = (wrong > SLIPS) & (wrong > TOLERATED * torch.cumsum(moving, 0))
    clock = torch.cumsum(samples.dt, 0)
    last = torch.searchsorted(at, torch.arange(len(clock), device=at.device), right=True) - 1
    known, last = last >= 0, last.clamp(min=0)
    since = clock - clock[at[last]]
    slowest = speed[last] - HARDEST_BRAKING * since
    vouched = ~moving[last] & (since < FRESH)
    denied = known & ((moving[last] & (slowest > MOVING)) | (unreliable[last] & ~vouched))
    still: Tensor = torch.where(alone & denied, 0.0, samples.stationary)
    return samples._replace(stationary=still)
