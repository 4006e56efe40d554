"""Fixes some time apart, of those that a receiver gave: errors that last then count once.

A receiver's error is mostly that of a second ago: multipath and the receiver's own filter last for
tens of seconds. Innovations from second to second hardly see it, so that likelihood takes it for
precision of the fixes, or for motion of the car. Over longer steps fixes are nearer to being
independent of each other, and what the car's own sensors do wrong has had time to show.
"""

import torch
from torch import Tensor

from navlearn.states import FixTiming

SLACK = 1e-6
"""By how much less than asked for fixes may be apart, s: times are sums."""


def spaced_fixes(timing: FixTiming, elapsed: Tensor, spacing: float) -> FixTiming:
    """Return where fixes fall, with those that come too soon marked as padding.

    Args:
        timing: Where the fixes of one drive fall, shape (M,) each; padding stays padding.
        elapsed: Time at the end of every interval, s, shape (T,).
        spacing: Least time from one fix that is kept to the next, s; 0 keeps all.

    Returns:
        Timing of the same shape: the first fix stays, then each that is ``spacing`` or more later
        than the last one kept; the others have index −1.
    """
    if spacing <= 0.0:
        return timing
    there = timing.index >= 0
    valid = elapsed[timing.index.clamp(min=0)] - timing.delay
    kept = torch.zeros_like(there)
    last = -torch.inf
    for k in torch.nonzero(there).flatten().tolist():
        if float(valid[k]) - last >= spacing - SLACK:
            kept[k], last = True, float(valid[k])
    return FixTiming(torch.where(kept, timing.index, -1), torch.where(kept, timing.delay, 0.0))
